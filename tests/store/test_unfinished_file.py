"""A file appears when it is complete, on every file system; a kill leaves nothing."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from robotctl.store.folder_store import unfinished_file

WRITER = """
import sys
from pathlib import Path
from robotctl.store.folder_store import unfinished_file
with unfinished_file(Path(sys.argv[1])) as file:
    file.write(bytes(100_000))
    print("written", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(params=["with links", "as on FAT"])
def folder(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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


def test_it_appears_under_a_free_name_only(folder: Path) -> None:
    with unfinished_file(folder) as file:
        file.write(b"first")
        assert not (folder / "a").exists()
        file.name_if_free(folder / "a")
    with unfinished_file(folder) as file:
        file.write(b"second")
        with pytest.raises(FileExistsError):
            file.name_if_free(folder / "a")
    assert [(path.name, path.read_bytes()) for path in folder.iterdir()] == [("a", b"first")]


def test_it_takes_the_place_of_another(folder: Path) -> None:
    for content in (b"first", b"second"):
        with unfinished_file(folder) as file:
            file.write(content)
            file.name_over(folder / "a")
    assert [(path.name, path.read_bytes()) for path in folder.iterdir()] == [("a", b"second")]


def test_an_error_leaves_nothing(folder: Path) -> None:
    with suppress(ZeroDivisionError), unfinished_file(folder) as file:
        file.write(b"half")
        raise ZeroDivisionError
    assert list(folder.iterdir()) == []


def test_a_writer_that_is_killed_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"written\n"
        writer.send_signal(signal.SIGKILL)
    assert list(tmp_path.iterdir()) == []
