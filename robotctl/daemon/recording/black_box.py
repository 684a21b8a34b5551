"""The black box: a clip of each emergency stop and error, cut by a separate process."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from robotctl.base.jobs import JobFailed, job_command, run_job
from robotctl.config import RecordingParams
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import PATIENCE_S, ClipJob, Moment

_log = logging.getLogger(__name__)

CLIP: Final = "robotctl.recording.keep.clip:clip_job"

CLIPPED: Final = (EventKind.EMERGENCY_STOP, EventKind.ERROR)


@dataclass(frozen=True, slots=True)
class ClipLimits:
    """Limits on the number of clips, and on the times for cutting them [s]."""

    waiting: int = 8
    clips: int = 100
    """Limit on the clips of one run of the daemon."""

    cut_s: float = 20.0
    end_s: float = 10.0
    """At the daemon's end, the limit on the time for cutting the remaining clips."""

    patience_s: float = PATIENCE_S
    """Added to each clip's time limit for the recorder to write."""


DEFAULT_LIMITS = ClipLimits()


def clip_command(job: ClipJob) -> Sequence[str]:
    """Return the command line that cuts a clip."""
    return job_command(CLIP, job)


class BlackBox:
    """Cuts a clip around each stop or error in a separate process. For the loop's thread."""

    def __init__(
        self,
        params: RecordingParams,
        recording: Path,
        *,
        command: Callable[[ClipJob], Sequence[str]] = clip_command,
        limits: ClipLimits = DEFAULT_LIMITS,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """Cut clips out of the folder `recording`; `now_ns` is the wall clock of the events."""
        self._command = command
        self._limits = limits
        self._now_ns = now_ns
        self._sleep = sleep
        self.params = params
        """`clip_before_s` and `clip_after_s` are the lengths of a clip."""

        self._recording = recording
        self._waiting: deque[RecordedEvent] = deque()
        self._came = asyncio.Event()
        self._cutting: asyncio.Task[None] | None = None
        self._ordered = 0

    def note(self, event: RecordedEvent) -> None:
        """Order a clip of an `event` in CLIPPED, if clips are on and no limit is reached."""
        if event.kind not in CLIPPED or not self.params.clip_before_s:
            return
        if len(self._waiting) >= self._limits.waiting or self._ordered >= self._limits.clips:
            _log.warning("no clip is cut of this %s: the limit is reached", event.kind.value)
            return
        self._ordered += 1
        self._waiting.append(event)
        self._came.set()

    async def run(self) -> None:
        """Cut each ordered clip `clip_after_s` after its event, until cancelled."""
        while True:
            self._came.clear()
            while self._waiting:
                since_s = (self._now_ns() - self._waiting[0].log_ns) / NS_PER_S
                after_s = self.params.clip_after_s
                await self._sleep(min(after_s - since_s, after_s))  # the clock may jump back
                await self._cut_next(self._limits.cut_s)
            await self._came.wait()

    async def finish(self) -> None:
        """Cut the clips that wait at the recording's end; begin none after `end_s` seconds."""
        until = time.monotonic() + self._limits.end_s
        if self._cutting is not None:
            await asyncio.wait({self._cutting}, timeout=self._limits.end_s)
        while self._waiting and time.monotonic() < until:
            await self._cut_next(until - time.monotonic())
        for event in self._waiting:
            _log.warning("no clip was cut of the %s: cut one with robotctl clip", event.kind.value)

    async def _cut_next(self, deadline_s: float) -> None:
        self._cutting = asyncio.create_task(self._cut(self._waiting.popleft(), deadline_s))
        await asyncio.shield(self._cutting)

    async def _cut(self, event: RecordedEvent, deadline_s: float) -> None:
        what, deadline_s = event.kind.value, deadline_s + self._limits.patience_s
        lengths_s = self.params.clip_before_s, self.params.clip_after_s
        job = ClipJob(self._recording, Moment.of(event), *lengths_s)
        try:
            async with asyncio.timeout(deadline_s):
                reports = await run_job(self._command(job))
        except TimeoutError:
            failure = f"its process took longer than {deadline_s:.0f} s"
        except JobFailed as failed:
            failure = str(failed)
        else:
            failure = "" if reports else "its process made no report"
        if failure:
            _log.warning("no clip was cut of the %s: %s", what, failure)
            return
        _log.info("clip of the %s: %s", what, reports[0]["target"])
        for sentence in reports[0]["lost"]:
            _log.warning("the clip is incomplete: %s", sentence)
