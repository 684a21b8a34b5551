"""A file that is replaced completely or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from robotctl.recording.disk.access import open_private, share_like


@contextmanager
def replaced_file(target: Path) -> Iterator[IO[bytes]]:
    """Yield a file that takes the place of `target` at the end of the block, unless it raises.

    It has the access rights of a recording in its folder. A link or a device is not replaced.

    Raises:
        OSError: It cannot be written, or there is something else than a file.
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
