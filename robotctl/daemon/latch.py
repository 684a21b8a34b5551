"""The emergency stop that outlives the process: a file, written and fsynced off the loop."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from robotctl.errors import RobotctlError
from robotctl.paths import chain_to, make_private

_log = logging.getLogger(__name__)


class Latch:
    """The latch of one robot. Changes are carried out in order, in one thread."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="latch")
        self._last: asyncio.Future[str] | None = None

    def read(self) -> str | None:
        """Return the reason of a latched stop, None where none is latched. Blocks.

        Raises UsageError if another user could have removed it.
        """
        chain_to(self._path.parent).check()
        try:
            return (
                self._path.read_text(encoding="utf-8", errors="replace").strip() or "unknown reason"
            )
        except FileNotFoundError:
            return None
        except OSError as error:  # in doubt, stopped
            return f"the latch {self._path} cannot be read: {error.strerror}"

    def set(self, reason: str) -> None:
        """Begin to remember the stop."""
        self._submit(lambda: self._write(reason))

    def clear(self) -> None:
        """Begin to forget the stop."""
        self._submit(self._remove)

    def when_settled(self, then: Callable[[str], None]) -> None:
        """Call `then(problem)` once every change so far is on the disk; "" where all went well."""
        if self._last is None or self._last.done():
            then("" if self._last is None else self._last.result())
        else:
            self._last.add_done_callback(lambda done: then(done.result()))

    async def close(self) -> None:
        """Wait for the last change."""
        if self._last is not None:
            await self._last
        self._thread.shutdown()

    def _submit(self, change: Callable[[], None]) -> None:
        self._last = asyncio.get_running_loop().run_in_executor(self._thread, _tried, change)

    def _write(self, reason: str) -> None:
        make_private(self._path.parent)
        partial = self._path.with_suffix(".new")
        with partial.open("w", encoding="utf-8") as file:
            file.write(reason)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(self._path)
        _sync_folder(self._path.parent)

    def _remove(self) -> None:
        with suppress(FileNotFoundError):
            self._path.unlink()
            _sync_folder(self._path.parent)


def _tried(change: Callable[[], None]) -> str:
    try:
        change()
    except (OSError, RobotctlError) as error:
        problem = f"the emergency-stop latch could not be saved: {error}"
        _log.error(problem)
        return problem
    return ""


def _sync_folder(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
