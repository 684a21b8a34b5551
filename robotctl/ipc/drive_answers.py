"""What the methods that drive answer, as it stands in JSON."""

from __future__ import annotations

from typing import TypedDict


class DriveFacts(TypedDict):
    """The drive that is going on, and its errors so far: of `kernel.types.DriveReport`."""

    what: str
    lap: int
    laps: int
    """0: until stopped."""
    distance_m: float
    duration_s: float
    cross_track_m: float | None
    """None where nothing is measured, as are the other errors: a velocity has no path."""
    cross_track_rms_m: float | None
    cross_track_max_m: float | None
    true_cross_track_rms_m: float | None
    """By the true pose of a robot that the daemon simulates; None for any other."""
    true_cross_track_max_m: float | None
    true_heading_rms_rad: float | None
    true_heading_max_rad: float | None
    true_closure_m: float | None
    heading_rms_rad: float | None
    heading_max_rad: float | None
    closure_m: float | None
    """At the end of the last lap; None before the first is complete."""


class DrivenPath(TypedDict):
    """The answer of `path`: points of the present or last drive, in the odometry frame [m]."""

    reference: list[list[float]]
    driven: list[list[float]]


class ModeAnswer(TypedDict):
    """The answer of `set_mode`, `reset`, `end_drive`, and of a `drive` that is not waited for."""

    message: str
    mode: str


class DriveAnswer(ModeAnswer, total=False):
    """The answer of `drive`; the figures are there when the call waited for the end of the drive.

    They are those of `kernel.types.DriveReport`; None stands for an unknown value.
    """

    laps: int
    distance_m: float | None
    cross_track_rms_m: float | None
    cross_track_max_m: float | None
    true_cross_track_rms_m: float | None
    true_cross_track_max_m: float | None
    true_heading_rms_rad: float | None
    true_heading_max_rad: float | None
    true_closure_m: float | None
    closure_m: float | None
    heading_rms_rad: float | None
    heading_max_rad: float | None
    duration_s: float | None


class HoldAnswer(ModeAnswer):
    """The answer of `hold`; a hold that is over has the `hold` 0, and `message` says why."""

    hold: int
