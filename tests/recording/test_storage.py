"""A write to a file on disk is complete, or raises OSError."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from robotctl.recording.disk.storage import MAX_PARTS, DiskFile, is_being_written


def test_writes_that_the_kernel_cuts_short_are_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dice = random.Random(12)
    whole = os.pwritev

    def cut_short(fd: int, parts: Sequence[memoryview], offset: int) -> int:
        data = b"".join(parts)
        return whole(fd, [data[: dice.randint(1, len(data))]], offset)

    monkeypatch.setattr(os, "pwritev", cut_short)
    file = DiskFile(tmp_path / "file")
    parts = [dice.randbytes(dice.randint(0, 50)) for _ in range(300)]
    file.write_at([b"begin", *parts], 0)
    file.write_at([bytearray(b"BEG"), memoryview(b"IN")], 0)
    file.close()
    assert (tmp_path / "file").read_bytes() == b"BEGIN" + b"".join(parts)


def test_more_parts_than_the_kernel_takes_are_written(tmp_path: Path) -> None:
    file = DiskFile(tmp_path / "file")
    file.write_at([b"%06d" % number for number in range(3 * MAX_PARTS)], 10)
    file.close()
    expected = b"".join(b"%06d" % number for number in range(3 * MAX_PARTS))
    assert (tmp_path / "file").read_bytes() == bytes(10) + expected


def test_a_disk_that_takes_nothing_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "pwritev", lambda fd, parts, offset: 0)
    file = DiskFile(tmp_path / "file")
    with pytest.raises(OSError, match="Input/output error"):
        file.write_at([b"data"], 0)
    file.close()


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "new")
    for name in ("file", "link"):
        with pytest.raises(FileExistsError):
            DiskFile(tmp_path / name)
    assert not (tmp_path / "new").exists()
    assert (tmp_path / "file").read_text() == "mine"


def test_a_folder_that_cannot_be_synced_is_no_reason_not_to_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fsync(fd: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fsync)
    code = errno.EINVAL
    DiskFile(tmp_path / "on_a_network").close()
    code = errno.EIO
    open_files = len(os.listdir("/proc/self/fd"))
    with pytest.raises(OSError, match="Input/output error"):
        DiskFile(tmp_path / "on_a_broken_disk")
    assert len(os.listdir("/proc/self/fd")) == open_files


def test_a_file_is_being_written_until_it_is_closed(tmp_path: Path) -> None:
    file = DiskFile(tmp_path / "file")
    assert is_being_written(tmp_path / "file")
    file.close()
    assert not is_being_written(tmp_path / "file")
    assert not is_being_written(tmp_path / "file")


def test_a_file_that_cannot_be_begun_is_not_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(fd: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output error"):
        DiskFile(tmp_path / "file")
    assert list(tmp_path.iterdir()) == []


def test_a_descriptor_that_failed_to_close_is_never_used_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def close_and_fail(fd: int, close: Callable[[int], None] = os.close) -> None:
        close(fd)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    file = DiskFile(tmp_path / "file")
    with monkeypatch.context() as patch:
        patch.setattr(os, "close", close_and_fail)
        with pytest.raises(OSError, match="Input/output error"):
            file.close()
    with (tmp_path / "other").open("wb"):  # gets the number of the descriptor
        with pytest.raises(OSError, match="Bad file descriptor"):
            file.write_at([b"wrong"], 0)
        file.close()
    assert (tmp_path / "other").read_bytes() == b""
