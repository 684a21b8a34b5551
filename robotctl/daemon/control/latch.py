"""The latched emergency stop: a file that outlives the process, written by a thread."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import NamedTuple

from robotctl.base.files import open_regular, sync_folder
from robotctl.base.paths import chain_to, make_private
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES
from robotctl.kernel.types import Cause

MAX_BYTES = 4096
"""Limit on the bytes that are read from the file."""

_CAUSE = "cause: "  # the first version wrote files without a cause
_CAUSES = {rule.cause.value: rule.cause for rule in RULES if rule.action is Mode.EMERGENCY_STOP}


class LatchedStop(NamedTuple):
    """An emergency stop that is not released."""

    reason: str
    cause: Cause


def read(path: Path) -> LatchedStop | None:
    """Return the latched stop, or None if there is none.

    A file that is unreadable or has no cause counts as a stop by the operator.

    Raises:
        UsageError: Another user can change the folder.
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
    """Write and sync the file. A power cut leaves either the old file or the new one.

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
    sync_folder(path.parent)


def remove(path: Path) -> None:
    """Remove the file, and sync its folder.

    Raises:
        OSError: The file cannot be removed.
    """
    with suppress(FileNotFoundError):
        path.unlink()
        sync_folder(path.parent)


def _read_text(path: Path) -> str:
    with open_regular(path) as file:
        return file.read(MAX_BYTES).decode("utf-8", errors="replace")


_log = logging.getLogger(__name__)

RETRY_S = 1.0
"""Pause before a change that failed is tried again."""

DISK_S = 2.0
"""How long a reply waits for a disk that hangs."""

Then = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class _Change:
    number: int
    carry_out: Callable[[], None]
    fault: str
    """What a restart does wrong if the change is not saved."""

    def failed(self, error: Exception) -> str:
        """Return a sentence about the failure of this change."""
        return f"{self.fault}: the emergency-stop latch could not be saved: {error}"


@dataclass(slots=True)
class _Waiter:
    number: int
    then: Then
    timer: asyncio.TimerHandle


class Latch:
    """The saved emergency stop of a robot, for the loop's thread; another writes the file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._work: SimpleQueue[_Change | None] = SimpleQueue()
        self._change: _Change | None = None
        """The last change that was requested."""
        self._settled = 0
        """The number of the last change that has been carried out or has failed."""
        self._busy_since: float | None = None
        self._problem = ""
        self._waiters: list[_Waiter] = []
        self._retry: asyncio.TimerHandle | None = None
        # A daemon thread: a disk that hangs must not delay the end of the process.
        self._thread = Thread(target=self._serve, name="latch", daemon=True)

    def read(self) -> LatchedStop | None:
        """Return the latched stop, or None if there is none. This blocks."""
        return read(self._path)

    def set(self, reason: str, cause: Cause) -> None:
        """Begin to save a stop on the disk; `when_settled` reports the result."""
        stop = LatchedStop(reason, cause)
        self._begin(partial(write, self._path, stop), "a restart would forget this stop")

    def clear(self) -> None:
        """Begin to remove the saved stop from the disk; `when_settled` reports the result."""
        fault = "a restart would stop the robot again"
        self._begin(partial(remove, self._path), fault)

    def when_settled(self, then: Then) -> None:
        """Call `then(problem)` when the last change settles, after DISK_S at the latest.

        `problem` is "" if the change is on the disk.
        """
        change = self._change
        if change is None or self._settled == change.number:
            then(self._problem)
            return
        waiter: _Waiter

        def give_up() -> None:
            self._waiters.remove(waiter)
            then(self._overdue(change))

        timer = asyncio.get_running_loop().call_later(DISK_S, give_up)
        waiter = _Waiter(change.number, then, timer)
        self._waiters.append(waiter)

    def warning(self) -> str:
        """Return a sentence if the file could not be brought up to date, else ""."""
        problem, since = self._problem, self._busy_since
        if since is not None and time.monotonic() - since > DISK_S and self._change is not None:
            problem = self._overdue(self._change)
        return f"{problem} (tried again each second)" if problem else ""

    async def close(self) -> None:
        """Wait until the last change has settled, at most DISK_S, and end the thread."""
        settled = asyncio.Event()
        self.when_settled(lambda _: settled.set())
        await settled.wait()
        if self._retry is not None:
            self._retry.cancel()
        self._work.put(None)

    def _begin(self, carry_out: Callable[[], None], fault: str) -> None:
        number = 1 if self._change is None else self._change.number + 1
        self._change = _Change(number, carry_out, fault)
        self._submit(self._change)

    def _submit(self, change: _Change) -> None:
        if self._busy_since is not None:
            return
        self._loop = asyncio.get_running_loop()
        if self._thread.ident is None:
            try:
                self._thread.start()
            except (RuntimeError, MemoryError) as error:  # the limit of threads is reached
                self._done(change, change.failed(error))
                return
        self._busy_since = time.monotonic()
        self._work.put(change)

    def _done(self, change: _Change, problem: str) -> None:
        self._busy_since = None
        self._settled = change.number
        if problem != self._problem:
            _log.error("%s", problem) if problem else _log.info("the latch is up to date again")
        self._problem = problem
        if self._retry is not None:
            self._retry.cancel()
        if self._change is not None and change is not self._change:
            self._submit(self._change)
        elif problem:
            self._retry = self._loop.call_later(RETRY_S, self._submit, change)
        answered = [waiter for waiter in self._waiters if waiter.number <= change.number]
        self._waiters = [waiter for waiter in self._waiters if waiter.number > change.number]
        for waiter in answered:
            waiter.timer.cancel()
            waiter.then(problem)

    def _overdue(self, change: _Change) -> str:
        return f"{change.fault}: the disk of {self._path} has not answered for {DISK_S:g} s"

    # In the latch's own thread

    def _serve(self) -> None:
        while (change := self._work.get()) is not None:
            problem = ""
            try:
                change.carry_out()
            except Exception as error:  # noqa: BLE001 - after any error the change is not saved
                problem = change.failed(error)
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._done, change, problem)
