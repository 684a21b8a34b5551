"""A bucket: failures are tried again or named, keys come from ~/.aws, no thread is left at exit."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.base.store import (
    AccessDenied,
    NoSuchObject,
    StoreError,
    StoreFailed,
    is_url,
    open_store,
)
from robotctl.base.store.bucket import RequestLoop, profile_keys
from tests.support.stores import FaultyBucket, Moved
from tests.support.waiting import loop_until, until

ROBOTS = "s3://robots"


def test_failures_of_five_percent_and_short_answers_are_not_noticed(bucket: FaultyBucket) -> None:
    data = bytes(range(250))
    bucket["run.mcap"] = data
    bucket.failing_share = bucket.short_share = 0.05
    store = open_store(ROBOTS)
    found = store.head("run.mcap")
    for begin in range(60):
        assert store.get_range(found, begin, begin + 50) == data[begin : begin + 50]
    assert bucket.requests > 61


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


@pytest.mark.parametrize(
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
