"""What the kernel knows of everything that motion depends on."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.types import Cause, Odometry


@dataclass(frozen=True, slots=True)
class SecondOdometry:
    """The last sample of a publisher of odometry that is not followed.

    `distance_m` and `angle_rad` are how far its pose was from that of the followed publisher.
    """

    source: int
    t_ns: int
    distance_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class OdometrySources:
    """Who publishes odometry: the robot follows one publisher at a time, by its number.

    `names` are (number, node) of the publishers found last. `dropped` counts the samples that were
    not used: those of other publishers, and those that cannot be true.
    """

    followed: int = 0
    names: tuple[tuple[int, str], ...] = ()
    dropped: int = 0
    second: SecondOdometry | None = None

    def name_of(self, source: int) -> str:
        """Return the node of a publisher, in words where it is not known."""
        return dict(self.names).get(source) or "a publisher without a name"


@dataclass(frozen=True, slots=True)
class CommandTopic:
    """Who else uses the velocity command.

    `foreign_t_ns` and `foreign_by` are of the last command that another node published; None
    where there was none. `listeners` take the type that we send (None: not looked at yet), and
    `other_types` are those with which others subscribe.
    """

    foreign_t_ns: int | None = None
    foreign_by: str = ""
    listeners: int | None = None
    other_types: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Stalls:
    """How often the control loop stalled, and its last stall: when, how long and why."""

    count: int = 0
    last_t_ns: int = 0
    last_s: float = 0.0
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Health:
    """What the kernel knows of everything that motion depends on; "" and () mean healthy.

    `odometry` is the last sample that could be true and `odometry_t_ns` when it came;
    `odometry_stamp_ns` and `odometry_fault` are of the last sample of all. These are of the
    publisher that is followed. `battery_in_percent` says that `battery.scale: auto` has met a
    level above 1.
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
    odometry_sources: OdometrySources = OdometrySources()
    command_topic: CommandTopic = CommandTopic()
    stalls: Stalls = Stalls()
    battery_in_percent: bool = False
