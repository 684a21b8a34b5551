"""What the kernel knows of everything that motion depends on."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.types import Cause, Odometry


@dataclass(frozen=True, slots=True)
class Health:
    """What the kernel knows of everything that motion depends on; "" and () mean healthy.

    `odometry` is the last sample that could be true and `odometry_t_ns` when it came;
    `odometry_stamp_ns` and `odometry_fault` are of the last sample of all.
    """

    odometry: Odometry | None = None
    odometry_t_ns: int = 0
    odometry_stamp_ns: int = 0
    odometry_fault: str = ""
    battery_level: float | None = None
    battery_t_ns: int = 0
    foreign_publishers: tuple[str, ...] = ()
    reported: tuple[tuple[Cause, str], ...] = ()
    path_error_m: float = 0.0
    tick_gap_s: float = 0.0
