"""The black box: a clip of each emergency stop and error, cut by a process of its own."""

from __future__ import annotations

import asyncio
import json
import logging
import subprocess
import sys
import time
from collections import deque
from pathlib import Path

from robotctl.config import RecordingParams
from robotctl.recording.clip import Moment
from robotctl.recording.clip_job import PATIENCE_S, ClipJob
from robotctl.recording.events import EventKind, RecordedEvent

_log = logging.getLogger(__name__)

CUTTER = (sys.executable, "-P", "-m", "robotctl.recording")
"""-P: what lies in the working directory is not imported in place of a library."""

CLIPPED = (EventKind.EMERGENCY_STOP, EventKind.ERROR)

MAX_WAITING = 8
MAX_CLIPS = 100
"""In one life of the daemon: whoever stops it a thousand times must not fill the disk with it."""

CUT_DEADLINE_S = 20.0
END_DEADLINE_S = 10.0
"""For all that is still to be cut when the daemon ends."""


class BlackBox:
    """Belongs to the loop's thread. The process has the lowest priority; nothing waits for it."""

    def __init__(self, params: RecordingParams, recording: Path) -> None:
        """Clips are cut out of the folder `recording`."""
        self._params = params
        self._recording = recording
        self._waiting: deque[RecordedEvent] = deque()
        self._came = asyncio.Event()
        self._cutting: asyncio.Future[None] | None = None
        self._ordered = 0

    def note(self, event: RecordedEvent) -> None:
        """Have a clip cut of `event`, if it is one of those."""
        if event.kind not in CLIPPED or not self._params.clip_before_s:
            return
        if len(self._waiting) >= MAX_WAITING or self._ordered >= MAX_CLIPS:
            _log.warning("no clip is cut of this %s: there are too many", event.kind.value)
            return
        self._ordered += 1
        self._waiting.append(event)
        self._came.set()

    async def run(self) -> None:
        """Cut what is ordered, each once it is over, until cancelled."""
        while True:
            self._came.clear()
            while self._waiting:
                since_s = (time.time_ns() - self._waiting[0].log_ns) / 1e9
                after_s = self._params.clip_after_s
                await asyncio.sleep(min(after_s - since_s, after_s))  # the clock may be set back
                await self._cut_next(CUT_DEADLINE_S)
            await self._came.wait()

    async def finish(self) -> None:
        """Cut what is still ordered, now that nothing more is recorded."""
        until = time.monotonic() + END_DEADLINE_S
        if self._cutting is not None:
            await asyncio.wait({self._cutting}, timeout=END_DEADLINE_S)
        while self._waiting and time.monotonic() < until:
            await self._cut_next(until - time.monotonic())
        for event in self._waiting:
            _log.warning("no clip was cut of the %s: see robotctl clip", event.kind.value)

    async def _cut_next(self, deadline_s: float) -> None:
        event = self._waiting.popleft()
        job = ClipJob(
            self._recording,
            Moment.of(event),
            self._params.clip_before_s,
            self._params.clip_after_s,
        )
        self._cutting = asyncio.get_running_loop().run_in_executor(None, _cut, job, deadline_s)
        await asyncio.shield(self._cutting)


def _cut(job: ClipJob, deadline_s: float) -> None:
    """Let a process do it; what comes of it, good or bad, stands in the log."""
    what = "event" if job.moment.kind is None else job.moment.kind.value
    try:
        ran = subprocess.run(
            [*CUTTER, job.to_json()],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=deadline_s + PATIENCE_S,
            process_group=0,  # a Ctrl-C in the daemon's terminal is the daemon's
            check=False,
        )
        said = json.loads(ran.stdout or "{}")
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        _log.warning("no clip was cut of the %s: %s", what, error)
        return
    if "target" in said:
        _log.info("clip of the %s: %s", what, said["target"])
        for sentence in said["lost"]:
            _log.warning("it lacks something: %s", sentence)
    else:
        reason = said.get("error") or (ran.stderr.splitlines() or ["it said nothing"])[-1]
        _log.warning("no clip was cut of the %s: %s", what, reason)
