"""What every store promises: a bucket of a real S3 server, and a folder, also one as on FAT."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.store import NoSuchObject, ObjectChanged, ObjectStore, Stamp, StoreError
from robotctl.base.store.folder_store import unfinished_file
from tests.support.stores import content


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
from pathlib import Path
from robotctl.base.store.folder_store import unfinished_file
with unfinished_file(Path(sys.argv[1])) as file:
    file.write(bytes(100_000))
    print("written", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["with links", "as on FAT"])
def target(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    if request.param == "as on FAT":
        opened = os.open

        def no_unnamed_files(path: Any, flags: int, *rest: Any, **others: Any) -> int:
            if flags & os.O_TMPFILE == os.O_TMPFILE:
                raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))
            return opened(path, flags, *rest, **others)

        def no_links(*_: Any, **__: Any) -> None:
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))

        monkeypatch.setattr(os, "open", no_unnamed_files)
        monkeypatch.setattr(os, "link", no_links)
    return tmp_path


def test_it_appears_under_a_free_name_only(target: Path) -> None:
    with unfinished_file(target) as file:
        file.write(b"first")
        assert not (target / "a").exists()
        file.name_if_free(target / "a")
    with unfinished_file(target) as file:
        file.write(b"second")
        with pytest.raises(FileExistsError):
            file.name_if_free(target / "a")
    assert [(path.name, path.read_bytes()) for path in target.iterdir()] == [("a", b"first")]


def test_it_takes_the_place_of_another(target: Path) -> None:
    for data in (b"first", b"second"):
        with unfinished_file(target) as file:
            file.write(data)
            file.name_over(target / "a")
    assert [(path.name, path.read_bytes()) for path in target.iterdir()] == [("a", b"second")]


def test_an_error_leaves_nothing(target: Path) -> None:
    with suppress(ZeroDivisionError), unfinished_file(target) as file:
        file.write(b"half")
        raise ZeroDivisionError
    assert list(target.iterdir()) == []


def test_a_writer_that_is_killed_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"written\n"
        writer.send_signal(signal.SIGKILL)
    assert list(tmp_path.iterdir()) == []
