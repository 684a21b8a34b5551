"""The file that keeps an emergency stop across restarts: the reason, then the cause."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES
from robotctl.kernel.types import Cause
from robotctl.paths import chain_to, make_private
from robotctl.regular_file import open_folder, open_regular

MAX_BYTES = 4096
"""A reason is a sentence: of a longer file only this much is read."""

_CAUSE = "cause: "
_CAUSES = {rule.cause.value: rule.cause for rule in RULES if rule.action is Mode.EMERGENCY_STOP}


class LatchedStop(NamedTuple):
    """An emergency stop that is not released."""

    reason: str
    cause: Cause


def read(path: Path) -> LatchedStop | None:
    """Read the latched stop, None if there is none; never wait for a FIFO or a device.

    A file that cannot be read is a stop by the operator, with the problem as its reason. A file
    without a cause, which the first version wrote, is a stop by the operator as well.

    Raises:
        UsageError: Another user could have removed the file.
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
    """Write and sync the file; a power cut leaves either the old file or the new one.

    Raises:
        OSError: The file cannot be written.
        UsageError: Another user could change the folder.
    """
    make_private(path.parent)
    partial = path.with_suffix(".new")
    with suppress(FileNotFoundError):
        partial.unlink()  # left by a killed writer; or a FIFO, on which open would wait
    text = f"{' '.join(stop.reason.split())}\n{_CAUSE}{stop.cause.value}\n"
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with open(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    _sync_folder(path.parent)


def remove(path: Path) -> None:
    """Remove the file, and sync its folder.

    Raises:
        OSError: The file cannot be removed.
    """
    with suppress(FileNotFoundError):
        path.unlink()
        _sync_folder(path.parent)


def _read_text(path: Path) -> str:
    with open_regular(path) as file:
        return file.read(MAX_BYTES).decode("utf-8", errors="replace")


def _sync_folder(folder: Path) -> None:
    with open_folder(folder) as descriptor:
        os.fsync(descriptor)
