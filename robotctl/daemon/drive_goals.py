"""Goals of the action `drive_pattern`, as requests for the kernel."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.base.errors import UsageError
from robotctl.daemon.api.driving import DrivingMethods
from robotctl.daemon.control.dispatcher import Control
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.patterns import PatternKind
from robotctl.kernel.types import DriveRequested
from robotctl.ros.nodes.drive_action import DriveProgress, Goal

MAX_SHOWN = 40
"""How many characters of an unknown pattern's name a refusal shows."""


class RequestedDrive:
    """A drive that a goal has requested: its reply, its progress and its end."""

    def __init__(self, control: Control, driving: DrivingMethods, event: DriveRequested) -> None:
        self._control = control
        self._driving = driving
        self._event = event
        self.ended = control.expect_end(event.request_id)
        self.reply = control.begin(event)

    def progress(self) -> DriveProgress | None:
        """Return the progress of the drive, or None if it is not running."""
        state = self._control.state
        drive, odometry = state.drive, state.health.odometry
        if drive is None or drive.request_id != self._event.request_id or odometry is None:
            return None
        laps = min(drive.progress.laps, drive.laps - 1) if drive.laps else drive.progress.laps
        return DriveProgress(drive.score.distance_m, laps, drive.cross_track_m(odometry.pose))

    def ramp_down(self) -> bool:
        """End the drive with a ramp; return whether it was still running."""
        return self._driving.ramp_down(
            self._event.request_id, f"{self._event.source}, which was cancelled"
        )


class DriveGoals:
    """Converts goals into requests for the kernel."""

    def __init__(
        self,
        control: Control,
        driving: DrivingMethods,
        is_remote: Callable[[], bool] = lambda: False,
    ) -> None:
        """`is_remote()` returns whether the present goal may come from another host."""
        self._control = control
        self._driving = driving
        self._is_remote = is_remote

    def begin(self, goal: Goal, source: str) -> RequestedDrive:
        """Request the drive of a goal at once.

        Raises:
            ValueError: The goal has 0 laps, an unknown pattern, or a speed above the limit.
        """
        if goal.laps == 0:
            raise ValueError(f"0 laps: a goal ends by itself: use 1 to {MAX_LAPS}")
        try:
            pattern = self._driving.pattern(
                _kind(goal.pattern), goal.size_m or None, goal.speed_mps or None
            )
        except UsageError as error:
            raise ValueError(str(error)) from None
        event = DriveRequested(
            time.monotonic_ns(),
            self._control.new_request_id(),
            pattern,
            goal.laps,
            goal.replace,
            source,
            remote=self._is_remote(),
        )
        return RequestedDrive(self._control, self._driving, event)


def _kind(name: str) -> PatternKind | None:
    try:
        return PatternKind(name) if name else None
    except ValueError:
        names = ", ".join(kind.value for kind in PatternKind)
        raise UsageError(f"no pattern {name[:MAX_SHOWN]!r}", f"use {names}") from None
