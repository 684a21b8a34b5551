"""How far a simulated robot truly is off the path of its drive: its odometry has errors, too."""

from __future__ import annotations

from collections.abc import Callable
from math import nan, sqrt
from typing import NamedTuple

from robotctl.kernel.drive import Drive, Score
from robotctl.kernel.geometry import Pose
from robotctl.kernel.types import DriveEnded


class TrueErrors(NamedTuple):
    """The errors of a drive by the true pose, as `kernel.types.DriveReport` has them by odometry.

    `closure_m` is NaN before a lap is complete.
    """

    cross_track_rms_m: float
    cross_track_max_m: float
    heading_rms_rad: float
    heading_max_rad: float
    closure_m: float


class GroundTruth:
    """The true errors of the present or last drive, as long as `truth` tells a true pose.

    A drive begins where odometry says, so the true path begins at the true pose of that moment.
    """

    def __init__(self) -> None:
        self.truth: Callable[[], Pose | None] = lambda: None
        self._drive: Drive | None = None
        self._measured_start = Pose()
        self._true_start = Pose()
        self._score = Score()
        self._laps = 0
        self._closure_m = nan

    def follow(self, drive: Drive, measured: Pose) -> None:
        """Take the true pose of the moment at which odometry measured a pose."""
        true = self.truth()
        if true is None or not drive.path.segments:
            return
        if self._drive is None or drive.request_id != self._drive.request_id:
            self._measured_start, self._true_start = measured, true
            self._score, self._laps, self._closure_m = Score(), 0, nan
        self._drive = drive
        pose = self._seen_from_odometry(true)
        self._score = drive.score_after(self._score, pose, 0.0)
        if drive.progress.laps != self._laps:
            self._laps = drive.progress.laps
            is_at_end = drive.finished and not drive.path.closed
            end = drive.origin.compose(drive.path.end) if is_at_end else drive.origin
            self._closure_m = end.distance(pose)

    def end(self, ended: DriveEnded) -> None:
        """Take the true pose of the moment at which a drive ends.

        Its last lap may end with it, so that no other sample is followed.
        """
        true, drive = self.truth(), self._drive
        if true is None or drive is None or drive.request_id != ended.request_id:
            return
        if ended.report.laps != self._laps:
            self._laps = ended.report.laps
            end = drive.origin if drive.path.closed else drive.origin.compose(drive.path.end)
            self._closure_m = end.distance(self._seen_from_odometry(true))

    def errors(self, request_id: int) -> TrueErrors | None:
        """Return the errors of the drive that this request began, None if they are not known."""
        if self._drive is None or request_id != self._drive.request_id:
            return None
        score = self._score
        return TrueErrors(
            sqrt(score.squared_error_sum / score.samples),
            score.max_error_m,
            sqrt(score.squared_heading_sum / score.samples),
            score.max_heading_rad,
            self._closure_m,
        )

    def _seen_from_odometry(self, true: Pose) -> Pose:
        return self._measured_start.compose(self._true_start.express(true))
