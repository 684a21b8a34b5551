"""How far a simulated robot truly is off the path of its drive: its odometry has errors, too."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import Pose


class TrueErrors(NamedTuple):
    """The true distance from the path: root mean square, and largest [m]."""

    rms_m: float
    max_m: float


class GroundTruth:
    """The true errors of the present or last drive, as long as `truth` tells a true pose.

    A drive begins where odometry says, so the true path begins at the true pose of that moment.
    """

    def __init__(self) -> None:
        self.truth: Callable[[], Pose | None] = lambda: None
        self._drive_id: int | None = None
        self._measured_start = Pose()
        self._true_start = Pose()
        self._samples = 0
        self._squared_sum = 0.0
        self._max_m = 0.0

    def follow(self, drive: Drive, measured: Pose) -> None:
        """Take the true pose of the moment at which odometry measured a pose."""
        true = self.truth()
        if true is None or not drive.path.segments:
            return
        if drive.request_id != self._drive_id:
            self._drive_id = drive.request_id
            self._measured_start, self._true_start = measured, true
            self._samples, self._squared_sum, self._max_m = 0, 0.0, 0.0
        off_m = drive.cross_track_m(self._measured_start.compose(self._true_start.express(true)))
        self._samples += 1
        self._squared_sum += off_m * off_m
        self._max_m = max(self._max_m, off_m)

    def errors(self, request_id: int) -> TrueErrors | None:
        """Return the errors of the drive that this request began, None if they are not known."""
        if request_id != self._drive_id:
            return None
        return TrueErrors(sqrt(self._squared_sum / self._samples), self._max_m)
