"""A file beside a recording is replaced completely or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from robotctl.recording.disk.atomic_output import replaced_file


def test_the_new_content_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    target.write_bytes(b"old")
    with replaced_file(target) as stream:
        stream.write(b"new")
        stream.flush()
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_what_ends_the_writing_leaves_the_old_content_alone(
    tmp_path: Path, error: BaseException
) -> None:
    target = tmp_path / "report.html"
    target.write_bytes(b"old")

    def write() -> None:
        with replaced_file(target) as stream:
            stream.write(b"half")
            raise error

    with pytest.raises(type(error)):
        write()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_a_device_and_a_folder_are_not_replaced(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"of another user")
    link = tmp_path / "link"
    link.symlink_to(other)
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for target in (link, fifo, tmp_path, Path(os.devnull)):
        with pytest.raises(OSError, match="no regular file"), replaced_file(target):
            pass
    assert other.read_bytes() == b"of another user"
    assert sorted(tmp_path.iterdir()) == [fifo, link, other]
