"""Separate processes that tidy the folder of recordings, and index the present one."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable
from contextlib import aclosing
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from robotctl.base.jobs import JobFailed, job_command, job_reports, run_job
from robotctl.base.processes import start
from robotctl.recording.keep.repair import TidyJob
from robotctl.recording.keep.retention import RetentionPolicy, TidyNote

_log = logging.getLogger(__name__)

TIDY: Final = "robotctl.recording.keep.repair:tidy_job"

MAX_PROBLEMS: Final = 10
"""Limit on the problems that the status shows."""


class Tidier:
    """Applies retention to the recordings, and repairs them, in processes of the lowest priority.

    Use it in the loop's thread. Files that a crash left are repaired only once, after `begun`.
    """

    def __init__(self, policy: RetentionPolicy, recording: Path) -> None:
        """`recording` is the folder of the present recording, in the folder to tidy."""
        self.policy = policy
        self._recordings = recording.parent
        self._recording = recording
        self.begun = asyncio.Event()
        """Set when the daemon is ready."""

        self.finished = asyncio.Event()
        """Set when a file of the present recording is finished."""

        self.problems: list[str] = []
        """The first MAX_PROBLEMS sentences about losses and failures."""

        self.on_removed: Callable[[str], None] = lambda path: None
        """Called with the path of each file that was removed."""

    async def run(self) -> None:
        """Tidy the folder once `begun` is set, and after each finished file, until cancelled."""
        await self.begun.wait()
        if await asyncio.to_thread(self._has_others):
            await self._tidy(repairs=True)
        while True:
            await self.finished.wait()
            self.finished.clear()
            await self._tidy(repairs=False)

    def _has_others(self) -> bool:
        try:
            return any(path != self._recording for path in self._recordings.iterdir())
        except OSError:
            return False

    async def _tidy(self, *, repairs: bool) -> None:
        job = TidyJob(self._recordings, self.policy, repairs)
        try:
            async with aclosing(job_reports(job_command(TIDY, job))) as notes:
                async for note in notes:
                    self._tell(TidyNote(**note))
        except JobFailed as failure:  # the next start continues
            text = f"the recordings in {self._recordings} are not tidied: {failure}"
            self._tell(TidyNote(text, problem=True))

    def _tell(self, done: TidyNote) -> None:
        _log.log(logging.WARNING if done.problem else logging.INFO, "%s", done.text)
        if done.removed:
            self.on_removed(done.removed)
        if done.problem and len(self.problems) < MAX_PROBLEMS:
            self.problems.append(done.text)


INDEX: Final = "robotctl.collection.indexing:index_job"

MAX_BYTES: Final = 2_000_000_000
"""Limit on the size of a recording that is indexed on the robot's machine."""

NOT_INSTALLED: Final = (
    "recordings are not indexed, because duckdb is not installed: pip install 'robotctl[parquet]'"
)


def has_grown(files: int, indexed: int) -> bool:
    """Return whether a recording has 1.5 times as many files as when it was last indexed."""
    return 2 * files >= 3 * indexed


class Indexer:
    """Indexes the present recording in processes of the lowest priority, one at a time.

    Call the methods in the loop's thread. The process that `finish` starts outlives the daemon.
    """

    def __init__(self, recording: Path, log: Path, *, enabled: bool) -> None:
        """The output of the last process is appended to `log` if that file exists."""
        self._recording = recording
        self._command = job_command(INDEX, {"recording": str(recording)})
        self._log = log
        self.enabled = enabled
        self._closed_files = 0
        self._file_closed = asyncio.Event()
        self._failures = 0
        self._last_failure = ""

    @property
    def problem(self) -> str:
        """A sentence with the number of failed indexings and the last reason, "" if none failed."""
        if not self._failures:
            return ""
        times = "once" if self._failures == 1 else f"{self._failures} times"
        return f"indexing failed {times}: {self._last_failure}"

    def file_finished(self) -> None:
        """Note that a file of the recording is closed and the next file has begun."""
        self._closed_files += 1
        self._file_closed.set()

    async def run(self) -> None:
        """Index the recording each time that it has grown enough, until cancelled."""
        indexed = 0
        while True:
            await self._file_closed.wait()
            self._file_closed.clear()
            if has_grown(self._closed_files, indexed) and await asyncio.to_thread(self._is_wanted):
                indexed = self._closed_files
                await self._index()

    async def finish(self) -> None:
        """Start to index the closed recording, and return at once."""
        await asyncio.to_thread(self._start_last)

    async def _index(self) -> None:
        try:
            await run_job(self._command)
        except JobFailed as failure:
            _log.warning("%s was not indexed: %s", self._recording, failure)
            self._failures += 1
            self._last_failure = str(failure)

    # Not in the loop's thread

    def _start_last(self) -> None:
        if not self._is_wanted():
            return
        try:
            log = self._log if self._log.exists() else Path(os.devnull)
            start(self._command, log=log).detach()
        except OSError as error:
            _log.warning("%s was not indexed: %s", self._recording, error)

    def _is_wanted(self) -> bool:
        if not self.enabled:
            return False
        if find_spec("duckdb") is None:
            _log.info(NOT_INSTALLED)
            self.enabled = False  # said once
            return False
        return _size(self._recording) <= MAX_BYTES


def _size(recording: Path) -> int:
    """Return the bytes of the files of a recording, 0 if they cannot be read."""
    try:
        return sum(file.stat().st_size for file in recording.glob("*.mcap"))
    except OSError:
        return 0
