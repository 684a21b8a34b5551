"""A file or folder that appears under its name when it is complete, or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import IO

from robotctl.base.errors import Refused
from robotctl.recording.disk.access import (
    cure_of,
    open_private,
    protect_like,
    reason_of,
    share_like,
)


@contextmanager
def replaced_file(target: Path) -> Iterator[IO[bytes]]:
    """Yield a file that replaces `target` at the end of the block, unless the block raises.

    The group may read the file if it may read the folder of `target`. A link is not replaced.

    Raises:
        OSError: The file cannot be written, or `target` is not a regular file.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(target.lstat().st_mode):
            raise FileExistsError(errno.EEXIST, "what is there is no regular file", str(target))
    unfinished = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with suppress(FileNotFoundError):
        unfinished.unlink()
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    try:
        with open(open_private(unfinished, flags), "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        share_like(unfinished, target.parent)
        unfinished.replace(target)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


@contextmanager
def atomic_output(target: Path, source: Path) -> Iterator[Path]:
    """Yield a path for the block's file or folder, which is renamed to `target` at the end.

    If the block raises, nothing remains. The path is in a hidden, private folder next to `target`;
    a kill leaves this folder there. The group may read the result if it may read `source`.

    Raises:
        Refused: `target` exists already, or cannot be written.
    """
    folder: Path | None = None
    try:
        _check_free(target)
        folder = Path(mkdtemp(prefix=f".{target.name[:100]}.", dir=target.parent))
        unfinished = folder / target.name
        yield unfinished
        for path in (*(unfinished.rglob("*") if unfinished.is_dir() else ()), unfinished):
            protect_like(path, source)
            _sync(path)
        _check_free(target)
        unfinished.rename(target)
        _sync(target.parent)
    except OSError as error:
        cure = "choose another name" if error.errno == errno.EEXIST else cure_of(error)
        raise Refused(f"cannot write {target}: {reason_of(error)}", cure) from error
    finally:
        if folder is not None:
            rmtree(folder, ignore_errors=True)


def _check_free(target: Path) -> None:
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
