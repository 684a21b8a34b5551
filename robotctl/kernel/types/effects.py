"""The effects: everything that `Kernel.step` returns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from robotctl.kernel.modes import Mode
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types.events import ParameterChanged
from robotctl.kernel.types.values import Cause, Twist


@dataclass(frozen=True, slots=True)
class PublishTwist:
    """A velocity command to send to the robot."""

    twist: Twist


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """The mode changed; `cause` is why the new mode is ERROR or EMERGENCY_STOP, else None."""

    previous: Mode
    mode: Mode
    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class LatchEmergencyStop:
    """An emergency stop that must survive restarts; a cause of None means the operator."""

    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop:
    """The release of the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request; `remedies` says what to do, in order, after a refusal."""

    request_id: int
    ok: bool
    message: str
    mode: Mode
    remedies: tuple[Remedy, ...] = ()


@dataclass(frozen=True, slots=True)
class DriveReport:
    """How well a drive followed its path, by odometry.

    `closure_m` is how far the robot was from the end of the path when the last complete lap ended,
    NaN before that. The heading errors are relative to the reference. A held velocity has no path:
    its four errors are 0, because nothing is measured; `without_errors` replaces them by NaN. In
    reports of older versions, the last three fields are NaN.
    """

    laps: int
    distance_m: float
    cross_track_rms_m: float
    cross_track_max_m: float
    closure_m: float
    heading_rms_rad: float = nan
    heading_max_rad: float = nan
    duration_s: float = nan

    def without_errors(self) -> DriveReport:
        """Return a copy in which the four tracking errors are NaN: they were not measured."""
        return replace(
            self,
            cross_track_rms_m=nan,
            cross_track_max_m=nan,
            heading_rms_rad=nan,
            heading_max_rad=nan,
        )


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """The drive that `request_id` began has ended; `completed` means all its laps were driven.

    `cause` is why the robot had to stop, None if a request or the last lap ended the drive.
    """

    request_id: int
    completed: bool
    reason: str
    report: DriveReport
    cause: Cause | None = None


Decision = (
    PublishTwist
    | ModeChanged
    | LatchEmergencyStop
    | ReleaseEmergencyStop
    | Reply
    | ParameterChanged
)
"""The effects in which kernels of different versions must agree on the same journal."""

Effect = Decision | DriveEnded
"""Everything that `Kernel.step` returns."""
