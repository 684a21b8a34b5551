"""The black box: a clip of each emergency stop and error, cut by a separate process."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robotctl.config import RecordingParams
from robotctl.kernel.units import NS_PER_S
from robotctl.processes import program, start
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import PATIENCE_S, ClipJob

_log = logging.getLogger(__name__)

CUTTER = program("robotctl.recording.keep.clip_process")

CLIPPED = (EventKind.EMERGENCY_STOP, EventKind.ERROR)


@dataclass(frozen=True, slots=True)
class ClipLimits:
    """Limits of the number of clips and of their time."""

    waiting: int = 8
    clips: int = 100
    """For one run of the daemon: a thousand stops must not fill the disk."""

    cut_s: float = 20.0
    end_s: float = 10.0
    """For all clips that are left when the daemon ends."""

    patience_s: float = PATIENCE_S
    """Added to each deadline: the process waits for the recorder's commit."""


DEFAULT_LIMITS = ClipLimits()


class BlackBox:
    """The starter of clip processes, for the loop's thread; they have the lowest priority."""

    def __init__(
        self,
        params: RecordingParams,
        recording: Path,
        *,
        cutter: Sequence[str] = CUTTER,
        limits: ClipLimits = DEFAULT_LIMITS,
        now_ns: Callable[[], int] = time.time_ns,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """`cutter` is the program that cuts clips out of the folder `recording`.

        `now_ns` is the wall clock of the events.
        """
        self._cutter = cutter
        self._limits = limits
        self._now_ns = now_ns
        self._sleep = sleep
        self.params = params
        """The lengths of the clips."""

        self._recording = recording
        self._waiting: deque[RecordedEvent] = deque()
        self._came = asyncio.Event()
        self._cutting: asyncio.Future[None] | None = None
        self._ordered = 0

    def note(self, event: RecordedEvent) -> None:
        """Order a clip of `event`, if it is of a kind that gets one."""
        if event.kind not in CLIPPED or not self.params.clip_before_s:
            return
        if len(self._waiting) >= self._limits.waiting or self._ordered >= self._limits.clips:
            _log.warning("no clip is cut of this %s: the limit is reached", event.kind.value)
            return
        self._ordered += 1
        self._waiting.append(event)
        self._came.set()

    async def run(self) -> None:
        """Cut each ordered clip once its time has passed, until cancelled."""
        while True:
            self._came.clear()
            while self._waiting:
                since_s = (self._now_ns() - self._waiting[0].log_ns) / NS_PER_S
                after_s = self.params.clip_after_s
                await self._sleep(min(after_s - since_s, after_s))  # the clock may jump back
                await self._cut_next(self._limits.cut_s)
            await self._came.wait()

    async def finish(self) -> None:
        """Cut the clips that are left, after the recording is closed."""
        until = time.monotonic() + self._limits.end_s
        if self._cutting is not None:
            await asyncio.wait({self._cutting}, timeout=self._limits.end_s)
        while self._waiting and time.monotonic() < until:
            await self._cut_next(until - time.monotonic())
        for event in self._waiting:
            _log.warning("no clip was cut of the %s: cut one with robotctl clip", event.kind.value)

    async def _cut_next(self, deadline_s: float) -> None:
        event = self._waiting.popleft()
        job = ClipJob(
            self._recording,
            Moment.of(event),
            self.params.clip_before_s,
            self.params.clip_after_s,
        )
        self._cutting = asyncio.get_running_loop().run_in_executor(None, self._cut, job, deadline_s)
        await asyncio.shield(self._cutting)

    # In a thread

    def _cut(self, job: ClipJob, deadline_s: float) -> None:
        """Run the process for one clip, and log its result."""
        what = "event" if job.moment.kind is None else job.moment.kind.value
        try:
            said = self._result(job, deadline_s + self._limits.patience_s)
        except OSError as error:  # no process, no descriptor
            said = {"error": str(error)}
        if "target" in said:
            _log.info("clip of the %s: %s", what, said["target"])
            for sentence in said["lost"]:
                _log.warning("the clip is incomplete: %s", sentence)
        else:
            _log.warning("no clip was cut of the %s: %s", what, said["error"])

    def _result(self, job: ClipJob, deadline_s: float) -> dict[str, Any]:
        """Return the report of the process, with "error" if it made none.

        Raises:
            OSError: The process cannot be started.
        """
        cutter = start([*self._cutter, job.to_json()])
        try:
            said = cutter.receive_one(deadline_s)
        except TimeoutError:
            cutter.close()
            return {"error": f"its process took longer than {deadline_s:.0f} s"}
        except (EOFError, ValueError):
            exit_code = cutter.close(self._limits.end_s)
            return {"error": f"its process ended with {exit_code} and made no report"}
        cutter.close(self._limits.end_s)
        return said
