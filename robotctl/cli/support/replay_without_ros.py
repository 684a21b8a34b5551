"""A recording seen without ROS: the view of `replay`, on a schedule of its own."""

from __future__ import annotations

import select
import time
from typing import Any, Final

from robotctl.cli.support.player_process import KEYS, QUIT
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.replay_screen import Screen
from robotctl.replay.controls import carry_out
from robotctl.replay.job import Job
from robotctl.replay.recorded_robot import Sight
from robotctl.replay.steering import Steering
from robotctl.replay.timeline import Span

PERIOD_S: Final = 0.1


def view(job: Job, sight: Sight, span: Span, screen: Screen) -> None:
    """Show what is recorded, at the job's rate, which is a number, until its end or a key."""
    viewer = _Viewer(job, sight, screen)
    screen.show({"start": {"length_s": span.length_ns / 1e9}})
    with Keyboard(viewer.suspend, viewer.resume) as keyboard:
        while not viewer.quit and (job.loop or viewer.position_ns <= span.length_ns):
            screen.show({"progress": viewer.progress()})
            ready, _, _ = select.select(keyboard.sources, [], [], PERIOD_S)
            for key in keyboard.read() if ready else "":
                viewer.press(key)
    viewer.steering.pause()
    screen.show({"progress": viewer.progress()})


class _Viewer:
    def __init__(self, job: Job, sight: Sight, screen: Screen) -> None:
        self.quit = False
        self.steering = Steering(job.rate, time.monotonic_ns, paused=job.paused)
        self.steering.begin(time.monotonic_ns() + round(job.delay_s * 1e9))
        self._resumes = False
        self._sight = sight
        self._screen = screen

    @property
    def position_ns(self) -> int:
        return self.steering.schedule.position_ns(time.monotonic_ns())

    def progress(self) -> dict[str, Any]:
        """Where the view is, as a player tells it."""
        schedule = self.steering.schedule
        position_s = self.position_ns / 1e9
        return {"position_s": position_s, "rate": schedule.rate, "paused": schedule.paused}

    def press(self, key: str) -> None:
        self.quit = self.quit or key == QUIT
        if key in KEYS:
            carry_out(KEYS[key], self.steering)
        next_ns = self._sight.next_ns
        if next_ns is not None and self.steering.takes_step(next_ns):
            self._sight.advance(next_ns)

    def suspend(self) -> None:
        self._resumes = not self.steering.schedule.paused
        self.steering.pause()
        self._screen.suspend()

    def resume(self) -> None:
        self._screen.resume()
        if self._resumes:
            self.steering.resume()
