"""Removes old recordings and repairs broken ones, in separate processes."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import aclosing
from pathlib import Path
from typing import Final

from robotctl.base.jobs import JobFailed, job_command, job_reports
from robotctl.recording.keep.repair import TidyJob
from robotctl.recording.keep.retention import RetentionPolicy, TidyNote

_log = logging.getLogger(__name__)

TIDY: Final = "robotctl.recording.keep.repair:tidy_job"

MAX_PROBLEMS: Final = 10
"""Limit on the problems that the status shows; the log has all."""


class Tidier:
    """Starts processes of the lowest priority that tidy the folder of recordings.

    The first process runs after `begin`: it removes what exceeds the retention policy, and repairs
    what a crash left. Each later process runs after `file_finished` and only removes. The daemon
    does not do this itself, as files may be of any origin and size. For the loop's thread.
    """

    def __init__(self, policy: RetentionPolicy, recording: Path) -> None:
        """`recording` is the folder of the present recording; its parent is the folder to tidy."""
        self.policy = policy
        self._recordings = recording.parent
        self._recording = recording
        self._begun = asyncio.Event()
        self._finished = asyncio.Event()
        self.problems: list[str] = []
        """The first MAX_PROBLEMS sentences about what was lost or has failed."""

        self.on_removed: Callable[[str], None] = lambda path: None
        """Called with the path of each file that was removed."""

    def begin(self) -> None:
        """Allow the first tidying; called when the daemon is ready."""
        self._begun.set()

    def file_finished(self) -> None:
        """Note that a file of the present recording is finished."""
        self._finished.set()

    async def run(self) -> None:
        """Tidy the folder after `begin` and after each finished file, until cancelled."""
        await self._begun.wait()
        if await asyncio.to_thread(self._has_others):
            await self._tidy(repairs=True)
        while True:
            await self._finished.wait()
            self._finished.clear()
            await self._tidy(repairs=False)

    def _has_others(self) -> bool:
        try:
            return any(path != self._recording for path in self._recordings.iterdir())
        except OSError:
            return False

    async def _tidy(self, *, repairs: bool) -> None:
        job = TidyJob(self._recordings, self.policy, repairs)
        try:
            async with aclosing(job_reports(job_command(TIDY, job.as_object()))) as notes:
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
