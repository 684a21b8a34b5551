"""What every store promises: a bucket of a real S3 server, and a folder, also one as on FAT.
A file at a URL is read by few ranges; a URL of more than a file is answered with the way.
A bucket: failures are tried again or named, keys come from ~/.aws, no thread is left at exit.
"""

from __future__ import annotations

import asyncio
import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from robotctl.base import files
from robotctl.base.errors import UsageError
from robotctl.base.store import MAX_READ_BYTES, RangeReader, RemoteFile, open_store, path_of
from robotctl.base.store.bucket import RequestLoop, profile_keys
from robotctl.base.store.folder_store import PREFIX, FolderStore
from robotctl.base.store.objects import (
    AccessDenied,
    NoSuchObject,
    ObjectChanged,
    ObjectStore,
    Stamp,
    StoreError,
    StoreFailed,
    is_url,
)
from tests.support.cases import for_each
from tests.support.stores import FaultyBucket, Moved, content, serving
from tests.support.stores import environment as s3_environment
from tests.support.waiting import loop_until, until


@pytest.fixture(params=["s3", "folder"])
def store(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> ObjectStore:
    """An empty store of each kind."""
    if request.param == "folder":
        return open_store(str(tmp_path / "store"))
    for name, value in s3_environment(request.getfixturevalue("s3_endpoint")).items():
        monkeypatch.setenv(name, value)
    return open_store(f"s3://robots/{tmp_path.name}")


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    with serving(monkeypatch) as served:
        yield served


def test_what_was_stored_is_listed_and_read_back(store: ObjectStore) -> None:
    assert store.put_if_absent("day 1/run.mcap", [b"0123456789"])
    assert store.put_if_absent("day 1/metadata.yaml", [b""])
    assert store.put_if_absent("day 10/run.mcap", [b"abc"])
    listed = {found.key: found for found in store.list()}
    assert set(listed) == {"day 1/run.mcap", "day 1/metadata.yaml", "day 10/run.mcap"}
    assert {found.key for found in store.list("day 1")} == set(listed) - {"day 10/run.mcap"}
    found = store.head("day 1/run.mcap")
    assert found == listed["day 1/run.mcap"]
    assert found.size_bytes == 10
    assert store.get_range(found, 2, 5) == b"234"
    assert store.get_range(found, 3, 3) == b""
    assert content(store, "day 1/run.mcap") == b"0123456789"


def test_a_name_is_given_only_once(store: ObjectStore) -> None:
    assert store.put_if_absent("result", [b"first"])
    assert not store.put_if_absent("result", [b"second"])
    assert content(store, "result") == b"first"


def test_a_range_past_the_end_is_an_error_and_not_a_short_answer(store: ObjectStore) -> None:
    store.put_if_absent("run.mcap", [b"0123456789"])
    found = store.head("run.mcap")
    with pytest.raises(StoreError):
        store.get_range(found, 5, 11)
    with pytest.raises(StoreError):
        store.get_range(found, 10, 11)


def test_an_object_that_was_replaced_is_not_read_any_further(store: ObjectStore) -> None:
    store.put("run.mcap", [b"0123456789"])
    found = store.head("run.mcap")
    assert store.get_range(found, 0, 5) == b"01234"
    store.put("run.mcap", [b"abcdefghij"])
    with pytest.raises(ObjectChanged, match="changed while it was read"):
        store.get_range(found, 0, 5)


def test_an_object_that_is_not_there_is_named(store: ObjectStore) -> None:
    store.put_if_absent("a/run.mcap", [b"0123456789"])
    with pytest.raises(NoSuchObject, match=r"a/other\.mcap does not exist"):
        store.head("a/other.mcap")


def test_hash_and_time_are_kept_with_an_object(store: ObjectStore) -> None:
    store.put("small", [b"x"], Stamp("a hash", 1_700_000_000_123_456_789))
    assert store.put_if_absent("large", [bytes(9_000_000)], Stamp("b", 1_600_000_000_000_000_000))
    assert not store.put_if_absent("large", [bytes(9_000_000)])
    assert store.head("small").modified_ns == 1_700_000_000_123_456_789
    assert store.head("large").modified_ns == 1_600_000_000_000_000_000
    if "s3://" in store.name:  # a folder has no place for hashes
        assert (store.head("small").sha256, store.head("large").sha256) == ("a hash", "b")


def test_a_large_object_is_stored_from_parts_of_any_length(store: ObjectStore) -> None:
    parts = [bytes([number]) * 3_000_000 for number in range(4)]
    store.put("large", parts)
    assert content(store, "large") == b"".join(parts)


def test_nothing_is_stored_if_the_parts_end_with_an_error(store: ObjectStore) -> None:
    def parts() -> Iterator[bytes]:
        yield bytes(9_000_000)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.put("large", parts())
    assert list(store.list()) == []


@pytest.mark.parametrize("key", ["", "/etc/passwd", "../run", "a/../b", "a//b", "a\n", "a" * 2000])
def test_a_name_that_leads_elsewhere_is_no_name(store: ObjectStore, key: str) -> None:
    with pytest.raises(StoreError, match="no object can have the name"):
        store.put_if_absent(key, [b""])
    with pytest.raises(StoreError, match="no object can have the name"):
        store.head(key)


WRITER = """
import sys
from collections.abc import Iterator
from pathlib import Path
from robotctl.base.store.folder_store import PREFIX, FolderStore
def parts() -> Iterator[bytes]:
    yield bytes(100_000)
    print("written", flush=True)
    sys.stdin.read()
FolderStore(Path(sys.argv[1])).put("a", parts())
"""


@pytest.fixture(params=["with links", "as on FAT"])
def target(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if request.param == "as on FAT":

        def no_links(*_: Any, **__: Any) -> None:
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))

        monkeypatch.setattr(os, "link", no_links)
    return tmp_path


def test_it_appears_under_a_free_name_only(target: Path) -> None:
    def parts(data: bytes) -> Iterator[bytes]:
        yield data
        assert (target / "a").exists() is (data == b"second")

    assert FolderStore(target).put_if_absent("a", parts(b"first"))
    assert not FolderStore(target).put_if_absent("a", parts(b"second"))
    assert [(path.name, path.read_bytes()) for path in target.iterdir()] == [("a", b"first")]


def test_it_takes_the_place_of_another(target: Path) -> None:
    for data in (b"first", b"second"):
        FolderStore(target).put("a", [data])
    assert [(path.name, path.read_bytes()) for path in target.iterdir()] == [("a", b"second")]


def test_an_error_leaves_nothing(target: Path) -> None:
    def parts() -> Iterator[bytes]:
        yield b"half"
        raise ZeroDivisionError

    with suppress(ZeroDivisionError):
        FolderStore(target).put("a", parts())
    assert list(target.iterdir()) == []


def test_a_writer_that_is_killed_leaves_a_hidden_file_that_is_removed_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"written\n"
        writer.send_signal(signal.SIGKILL)
    assert [path.name.startswith(PREFIX) for path in tmp_path.iterdir()] == [True]
    assert list(FolderStore(tmp_path).list()) == []
    FolderStore(tmp_path).put("a", [b""])
    assert len(list(tmp_path.iterdir())) == 2  # its writer may be at work
    monkeypatch.setattr(files, "ABANDONED_S", -1.0)
    FolderStore(tmp_path).put("a", [b""])
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


KIB = 1 << 10
MIB = 1 << 20


class Served:
    """An object whose every eight bytes tell their offset; it counts the requests."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.asked: list[tuple[int, int]] = []
        self.failure: StoreError | None = None

    def fetch(self, begin: int, end: int) -> bytes:
        assert 0 <= begin < end <= self.size
        self.asked.append((begin, end))
        if self.failure is not None:
            raise self.failure
        return self.content(begin, end)

    def content(self, begin: int, end: int) -> bytes:
        first = begin // 8
        words = b"".join(n.to_bytes(8, "big") for n in range(first, (end + 7) // 8))
        return words[begin - 8 * first : end - 8 * first]


def reader_of(served: Served) -> RangeReader:
    return RangeReader(served.size, served.fetch)


@for_each("seed", range(6))
def test_any_reads_return_what_is_there(seed: int) -> None:
    chance = random.Random(seed)
    served = Served(chance.randrange(1, 2 * MIB))
    reader = reader_of(served)
    for _ in range(60):
        offset, length = chance.randrange(served.size), chance.randrange(200 * KIB)
        end = min(offset + length, served.size)
        assert reader.read(offset, length) == served.content(offset, end)


def test_small_reads_side_by_side_are_one_request() -> None:
    served = Served(10 * MIB)
    reader = reader_of(served)
    for offset in range(0, 60 * KIB, 100):
        reader.read(offset, 100)
    reader.read(10 * MIB - 37, 37)
    reader.read(10 * MIB - 9000, 5000)
    assert len(served.asked) == 2


def test_reading_from_start_to_end_takes_larger_and_larger_requests() -> None:
    served = Served(12 * MIB)
    reader = reader_of(served)
    for offset in range(0, served.size, 100 * KIB):
        reader.read(offset, 100 * KIB)
    assert len(served.asked) < 10
    assert sum(end - begin for begin, end in served.asked) == served.size


def test_a_failure_is_told_again_without_another_request() -> None:
    served = Served(MIB)
    reader = reader_of(served)
    served.failure = StoreFailed("gone")
    for _ in range(3):
        with pytest.raises(StoreFailed, match="gone"):
            reader.read(0, 10)
    assert len(served.asked) == 1


def test_no_read_is_larger_than_any_part_of_a_recording() -> None:
    served = Served(10**15)
    with pytest.raises(StoreError, match="claims to have"):
        reader_of(served).read(0, MAX_READ_BYTES + 1)
    assert served.asked == []


def test_a_url_of_a_file_is_a_path_of_it() -> None:
    path = path_of("s3://robots/day%201/run.mcap")
    assert isinstance(path, RemoteFile)
    assert (str(path), path.name, path.stem) == ("s3://robots/day%201/run.mcap", "run.mcap", "run")
    assert type(path_of("file:///tmp/a%20b.mcap")) is type(Path())
    assert str(path_of("file://localhost/tmp/a%20b.mcap")) == "/tmp/a b.mcap"
    with pytest.raises(UsageError, match="file of the computer 'elsewhere'"):
        path_of("file://elsewhere/run.mcap")
    with pytest.raises(UsageError, match="first robotctl sync s3://robots/day DIR"):
        path_of("s3://robots/day/")


ROBOTS = "s3://robots"


def test_failures_of_five_percent_and_short_answers_are_not_noticed(bucket: FaultyBucket) -> None:
    data = bytes(range(250))
    bucket["run.mcap"] = data
    bucket.failing_share = bucket.short_share = 0.05
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    for begin in range(25):
        assert store.get_range(found, begin, begin + 50) == data[begin : begin + 50]
    assert bucket.requests > 26


def test_a_store_that_only_fails_is_an_error_after_some_tries(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.base.store.bucket.MAX_RETRIES", 2)
    bucket["run.mcap"] = b"0123456789"
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    bucket.short_share = 1.0
    with pytest.raises(StoreFailed, match=r"s3://robots/run\.mcap: .* broke off"):
        store.get_range(found, 0, 5)
    assert bucket.requests == 1 + 2 * 3


def test_an_object_that_vanishes_is_named(bucket: FaultyBucket) -> None:
    bucket["run.mcap"] = b"0123456789"
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    bucket.objects.clear()
    with pytest.raises(NoSuchObject, match=r"s3://robots/run\.mcap does not exist"):
        store.get_range(found, 5, 10)


def test_a_claimed_size_takes_no_memory(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.base.store.bucket.MAX_RETRIES", 1)
    bucket["run.mcap"] = b"0123456789"
    bucket.lying_size = 10**15
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    assert found.size_bytes == 10**15
    with pytest.raises(StoreFailed):
        store.get_range(found, 10**14, 10**14 + 10)


def test_refused_access_is_told_with_its_cure_and_without_secrets(bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 403
    with pytest.raises(AccessDenied) as denied:
        open_store(ROBOTS).put_if_absent("run.mcap", [b""])
    assert str(denied.value).startswith(
        "s3://robots/run.mcap: access is denied (SlowDown): set AWS_ACCESS"
    )
    assert "very-secret" not in repr(denied.value)


def test_a_bucket_of_another_region_is_told(bucket: FaultyBucket) -> None:
    bucket.before = lambda served, method, key: 301
    with pytest.raises(StoreFailed, match="sends requests elsewhere: set AWS_REGION"):
        open_store(ROBOTS).head("run.mcap")


def test_a_redirect_is_followed(bucket: FaultyBucket) -> None:
    bucket["run.mcap"] = b"0123456789"
    bucket["old.mcap"] = Moved("/robots/run.mcap")
    store = open_store(f"{bucket.endpoint}/robots")
    assert store.get_range(store.head("old.mcap"), 2, 5) == b"234"


def test_a_bucket_that_does_not_exist_is_named(
    monkeypatch: pytest.MonkeyPatch, s3_endpoint: str
) -> None:
    for name, value in {"AWS_ENDPOINT_URL": s3_endpoint, "AWS_ALLOW_HTTP": "true"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    with pytest.raises(NoSuchObject, match="s3://nowhere: there is no such bucket"):
        list(open_store("s3://nowhere").list())


def test_a_connection_without_encryption_must_be_asked_for(
    bucket: FaultyBucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    with pytest.raises(StoreFailed, match=r"would not be encrypted: .* AWS_ALLOW_HTTP=true"):
        open_store(ROBOTS).head("run.mcap")
    with pytest.raises(UsageError, match=r"would not be encrypted: .* AWS_ALLOW_HTTP=true"):
        open_store("http://robots.example/x")


def test_a_server_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    monkeypatch.setattr("robotctl.base.store.bucket.MAX_RETRIES", 0)
    with pytest.raises(StoreFailed, match="refuses the connection: check the network"):
        open_store("http://127.0.0.1:9").head("run.mcap")


@for_each(
    "url",
    ["ftp://host/x", "s3://", "https://user:very-secret@host/x", "https://host/x?very-secret"],
)
def test_a_wrong_url_is_told_without_what_may_be_a_password(url: str) -> None:
    assert is_url(url)
    with pytest.raises(UsageError) as wrong:
        open_store(url)
    assert "very-secret" not in str(wrong.value)


def test_a_missing_library_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(UsageError, match=r"not installed: pip install 'robotctl\[store\]'"):
        open_store("s3://robots/x")


def test_a_link_below_a_folder_is_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret").write_bytes(b"1")
    folder = tmp_path / "store"
    folder.mkdir()
    (folder / "folder").symlink_to(outside)
    (folder / "file").symlink_to(outside / "secret")
    store = open_store(str(folder))
    assert list(store.list()) == []
    for key in ("file", "folder/secret"):
        with pytest.raises(StoreError):
            store.head(key)
    with pytest.raises(StoreError):
        store.put_if_absent("folder/new", [b""])
    assert [path.name for path in outside.iterdir()] == ["secret"]


def test_ctrl_c_ends_a_request_at_once_and_quietly(bucket: FaultyBucket) -> None:
    asked = []

    def hang(served: FaultyBucket, method: str, key: str) -> None:
        asked.append(key)
        time.sleep(3)

    bucket.before = hang
    program = "from robotctl.base.store import open_store; open_store('s3://robots').head('x')"
    with subprocess.Popen(
        [sys.executable, "-c", program], env=dict(os.environ), stderr=subprocess.PIPE
    ) as process:
        deadline = time.monotonic() + 30
        while not asked and time.monotonic() < deadline:
            time.sleep(0.01)
        interrupted = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert time.monotonic() - interrupted < 2
    assert errors.rstrip().endswith(b"KeyboardInterrupt")
    assert b"panicked" not in errors


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    (tmp_path / "credentials").write_text(
        "[default]\naws_access_key_id = ONE\naws_secret_access_key = 50%off\n"
        "[robots]\naws_access_key_id = TWO\naws_secret_access_key = s\naws_session_token = t\n"
    )
    (tmp_path / "config").write_text("[default]\nregion = eu-west-1\n[profile robots]\nx = y\n")
    return {
        "AWS_SHARED_CREDENTIALS_FILE": str(tmp_path / "credentials"),
        "AWS_CONFIG_FILE": str(tmp_path / "config"),
    }


def test_a_profile_gives_keys_and_region(environment: dict[str, str]) -> None:
    assert profile_keys(environment) == {
        "access_key_id": "ONE",
        "secret_access_key": "50%off",
        "region": "eu-west-1",
    }
    assert profile_keys(environment | {"AWS_PROFILE": "robots"}) == {
        "access_key_id": "TWO",
        "secret_access_key": "s",
        "session_token": "t",
    }


def test_the_environment_counts_more(environment: dict[str, str]) -> None:
    assert profile_keys(environment | {"AWS_ACCESS_KEY_ID": "x"}) == {}
    assert profile_keys(environment | {"AWS_SKIP_SIGNATURE": "true"}) == {}
    assert "region" not in profile_keys(environment | {"AWS_REGION": "us-east-1"})


@pytest.mark.parametrize("text", ["", "no section", "[default]\nregion = x\n", "\0\udc80"])
def test_a_file_without_keys_gives_none(environment: dict[str, str], text: str) -> None:
    Path(environment["AWS_SHARED_CREDENTIALS_FILE"]).write_bytes(text.encode(errors="replace"))
    assert profile_keys(environment) == {}
    assert profile_keys(environment | {"AWS_PROFILE": "absent"}) == {}


def test_requests_are_signed_with_the_keys_of_a_profile(
    bucket: FaultyBucket, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    bucket["run.mcap"] = b"0"
    open_store("s3://robots").head("run.mcap")
    (authorization,) = bucket.authorizations
    assert "Credential=ONE/" in authorization


async def _interrupts_the_wait() -> None:
    main = threading.main_thread().ident
    assert main is not None
    await loop_until(lambda: sys._current_frames()[main].f_code.co_name == "wait")
    signal.pthread_kill(main, signal.SIGINT)
    await asyncio.Event().wait()


async def _answers() -> int:
    return 1


async def _hangs() -> None:
    await asyncio.Event().wait()


@pytest.fixture
def slept() -> list[float]:
    return []


@pytest.fixture
def requests(slept: list[float]) -> RequestLoop:
    return RequestLoop(now_s=lambda: 100.0, sleep=slept.append)


def test_the_exit_waits_for_the_library_also_where_the_request_has_been_cancelled_before(
    requests: RequestLoop, slept: list[float]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        requests.run(_interrupts_the_wait())
    until(lambda: not asyncio.all_tasks(requests.loop))
    requests.end()
    assert slept == [0.5]


def test_the_exit_cancels_what_is_still_under_way(
    requests: RequestLoop, slept: list[float]
) -> None:
    requests.start(_hangs())
    requests.end()
    assert slept == [0.5]


def test_the_exit_waits_for_nothing_after_requests_that_were_answered(
    requests: RequestLoop, slept: list[float]
) -> None:
    assert requests.run(_answers()) == 1
    requests.end()
    assert slept == []
