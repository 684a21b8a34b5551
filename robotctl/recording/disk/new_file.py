"""A new file that is created completely or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from robotctl.errors import Refused
from robotctl.recording.disk.storage import DiskFile, Storage


@contextmanager
def new_file(target: Path, open_file: Callable[[Path], Storage] = DiskFile) -> Iterator[Storage]:
    """Create `target` for the block; if the block raises, `target` is removed.

    Raises:
        Refused: `target` exists already, or cannot be written.
    """
    try:
        storage = open_file(target)
    except (OSError, ValueError) as error:
        raise Refused(f"cannot write {target}: {_reason(error)}") from error
    try:
        yield storage
    except BaseException as error:
        with suppress(OSError):
            target.unlink()
        if isinstance(error, OSError):
            raise Refused(f"cannot write {target}: {_reason(error)}") from error
        raise
    finally:
        with suppress(OSError):  # it is synced, or it is gone
            storage.close()


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
