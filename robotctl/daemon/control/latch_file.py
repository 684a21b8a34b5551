"""The file that latches an emergency stop over restarts: the reason, then the cause."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES
from robotctl.kernel.types import Cause
from robotctl.paths import chain_to, make_private
from robotctl.regular_file import open_regular

MAX_BYTES = 4096
"""A reason is a sentence; a longer file is not one of ours, and is read up to here."""

_CAUSE = "cause: "
_CAUSES = {rule.cause.value: rule.cause for rule in RULES if rule.action is Mode.EMERGENCY_STOP}


class LatchedStop(NamedTuple):
    """An emergency stop that nobody has released."""

    reason: str
    cause: Cause


def read(path: Path) -> LatchedStop | None:
    """Return the latched stop, None where none is latched; never waits for a FIFO or a device.

    What cannot be read is a stop by the operator, with the problem as its reason. So is a file
    without a cause, as the first version wrote it. Raises UsageError if another user could have
    removed the file.
    """
    chain_to(path.parent).check()
    try:
        text = _read_text(path)
    except FileNotFoundError:
        if not path.is_symlink():
            return None
        problem = "it is a link to nothing"
    except OSError as error:
        problem = error.strerror or str(error)
    else:
        *lines, last = text.strip().split("\n")
        cause = _CAUSES.get(last.removeprefix(_CAUSE)) if last.startswith(_CAUSE) else None
        reason = " ".join(lines if cause else [*lines, last])
        return LatchedStop(reason or "unknown reason", cause or Cause.OPERATOR_STOP)
    return LatchedStop(f"the latch {path} cannot be read: {problem}", Cause.OPERATOR_STOP)


def write(path: Path, stop: LatchedStop) -> None:
    """Write the file and sync it; a power cut leaves the old file or the new one.

    Raises:
        OSError: The disk does not take it.
        UsageError: Another user could change the folder.
    """
    make_private(path.parent)
    partial = path.with_suffix(".new")
    with suppress(FileNotFoundError):
        partial.unlink()  # of a writer that was killed; or a FIFO, whose opening would wait
    text = f"{' '.join(stop.reason.split())}\n{_CAUSE}{stop.cause.value}\n"
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with open(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    _sync_folder(path.parent)


def remove(path: Path) -> None:
    """Remove the file, and sync its folder; raises OSError."""
    with suppress(FileNotFoundError):
        path.unlink()
        _sync_folder(path.parent)


def _read_text(path: Path) -> str:
    with open_regular(path) as file:
        return file.read(MAX_BYTES).decode("utf-8", errors="replace")


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
