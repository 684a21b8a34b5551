"""replay --draw-only: draw a recording in the terminal, without ROS."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from robotctl.cli.commands.replay.keys import KEYS, QUIT
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.replay_screen import Screen, screen
from robotctl.errors import UsageError
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.replay.commands import carry_out
from robotctl.replay.job import Job
from robotctl.replay.playback_control import PlaybackControl
from robotctl.replay.recorded_robot import RecordedRobot
from robotctl.replay.timeline import Span, span_of

PERIOD_S: Final = 0.1
"""How often the robot is drawn."""


def draw_command(job: Job, *, quiet: bool) -> None:
    """Show the recording at the job's rate until its end or the quit key.

    Raises:
        UsageError: The rate is `max`, or the recording has nothing to draw.
    """
    if job.rate is None:
        raise UsageError("--draw-only cannot draw at --rate max", "give --rate a number")
    with recorded_robot(job) as (robot, span), screen(robot, quiet=quiet) as shown:
        viewer = _Viewer(job, robot, shown)
        shown.show({"start": {"length_s": span.length_ns / NS_PER_S}})
        with Keyboard(viewer.suspend, viewer.resume) as keyboard:
            while not viewer.quit and (job.loop or viewer.position_ns <= span.length_ns):
                shown.show({"progress": viewer.progress()})
                ready, _, _ = select.select(keyboard.sources, [], [], PERIOD_S)
                for key in keyboard.read() if ready else "":
                    viewer.press(key)
        viewer.control.pause()
        shown.show({"progress": viewer.progress()})


@contextmanager
def recorded_robot(job: Job) -> Iterator[tuple[RecordedRobot, Span]]:
    """Open the recording, and yield its robot and the span of the recording that is played."""
    with Recording(job.file) as recording:
        span = span_of(recording.info(), job)
        yield RecordedRobot(recording, span, loop=job.loop), span


class _Viewer:
    """The position in the recording, controlled by keys."""

    def __init__(self, job: Job, robot: RecordedRobot, screen: Screen) -> None:
        self.quit = False
        self.control = PlaybackControl(job.rate, time.monotonic_ns, paused=job.paused)
        self.control.begin(time.monotonic_ns() + round(job.delay_s * NS_PER_S))
        self._was_playing = False
        self._robot = robot
        self._screen = screen

    @property
    def position_ns(self) -> int:
        return self.control.schedule.position_ns(time.monotonic_ns())

    def progress(self) -> dict[str, Any]:
        """Return position, rate and pause in the form that the player process sends."""
        schedule = self.control.schedule
        position_s = self.position_ns / NS_PER_S
        return {"position_s": position_s, "rate": schedule.rate, "paused": schedule.paused}

    def press(self, key: str) -> None:
        self.quit = self.quit or key == QUIT
        if key in KEYS:
            carry_out(KEYS[key], self.control)
        next_ns = self._robot.next_ns
        if next_ns is not None and self.control.takes_step(next_ns):
            self._robot.advance(next_ns)

    def suspend(self) -> None:
        """Pause while this process is stopped."""
        self._was_playing = not self.control.schedule.paused
        self.control.pause()
        self._screen.suspend()

    def resume(self) -> None:
        """Continue, unless the replay was paused before `suspend`."""
        self._screen.resume()
        if self._was_playing:
            self.control.resume()
