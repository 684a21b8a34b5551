"""What other parameters change in a recording: the object of `replay --what-if`, with types."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robotctl.fleet.typed import Typed


@dataclass(frozen=True, slots=True)
class Pair:
    """A number with the recorded parameters, and with the other ones."""

    recorded: float
    what_if: float


@dataclass(frozen=True, slots=True)
class Apart:
    """How far the commands are apart; `max_after_s` is None if they are equal."""

    rms: float
    max: float
    max_after_s: float | None


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """The first event on which both kernels decide differently."""

    after_s: float
    event: str
    recorded: tuple[str, ...]
    what_if: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Failure:
    """The first event at which only the kernel with other parameters could not go on."""

    after_s: float
    text: str


@dataclass(frozen=True, slots=True)
class OtherAnswer:
    """A request that gets another answer."""

    after_s: float
    request_id: int
    recorded: str
    what_if: str


@dataclass(frozen=True, slots=True)
class Measured:
    """What the robot did in a drive, under the recorded commands; None is not known."""

    laps: int
    distance_m: float | None
    rms_error_m: float | None
    max_error_m: float | None


@dataclass(frozen=True, slots=True)
class Commanded:
    """What one kernel decided in a drive; the last five are None before its end."""

    modes_s: dict[str, float]
    commanded_m: float
    max_linear_mps: float
    max_angular_rps: float
    duration_s: float | None
    completed: bool | None
    ended: str | None
    cause: str | None
    end_mode: str | None

    @property
    def end(self) -> tuple[bool | None, str | None, str | None]:
        """How it ends, without the numbers of the reason."""
        return self.completed, self.cause, self.end_mode


@dataclass(frozen=True, slots=True)
class DriveChange:
    """A drive with both parameters; a side is None where the drive did not begin."""

    drive: int
    request_id: int
    after_s: float
    measured: Measured | None
    recorded: Commanded | None
    what_if: Commanded | None

    @property
    def ends_otherwise(self) -> bool:
        """Whether only one of both begins it, or it has another cause or mode at its end."""
        mine, theirs = self.recorded, self.what_if
        return mine is None or theirs is None or mine.end != theirs.end


@dataclass(frozen=True, slots=True)
class Change:
    """What other parameters change in one recording; the robot does not react to them."""

    duration_s: float
    settings: dict[str, dict[str, Any]]
    ticks: int
    linear_mps: Apart
    angular_rps: Apart
    modes_s: dict[str, Pair]
    mode_differs_s: float
    first_difference: FirstDifference | None
    failure: Failure | None
    drives: tuple[DriveChange, ...]
    no_drive: dict[str, str]
    answers: tuple[OtherAnswer, ...]
    answer_count: int
    missing: tuple[str, ...]

    @property
    def differs(self) -> bool:
        """Whether modes or answers change, not only velocities, or the kernel fails."""
        return bool(self.mode_differs_s or self.answer_count or self.failure)


@dataclass(frozen=True, slots=True)
class Totals:
    """The numbers of all drives in many recordings."""

    drives: int
    end_otherwise: int
    modes_s: dict[str, Pair]
    """Of the whole recordings, not only of their drives."""

    commanded_m: Pair
    max_linear_mps: Pair
    max_angular_rps: Pair


_change = Typed(Change)


def change_of(found: Mapping[str, Any]) -> Change:
    """Return the object of `replay --what-if` with its types."""
    return _change(found)


def totals_of(changes: Iterable[Change]) -> Totals:
    """Return the totals of some recordings."""
    all_changes = list(changes)
    drives = [drive for change in all_changes for drive in change.drives]
    before = [each.recorded for each in drives if each.recorded is not None]
    after = [each.what_if for each in drives if each.what_if is not None]
    modes = dict.fromkeys(mode for change in all_changes for mode in change.modes_s)
    linear = [_largest(each.max_linear_mps for each in side) for side in (before, after)]
    angular = [_largest(each.max_angular_rps for each in side) for side in (before, after)]
    return Totals(
        drives=len(drives),
        end_otherwise=sum(each.ends_otherwise for each in drives),
        modes_s={
            mode: Pair(
                sum(each.modes_s[mode].recorded for each in all_changes if mode in each.modes_s),
                sum(each.modes_s[mode].what_if for each in all_changes if mode in each.modes_s),
            )
            for mode in modes
        },
        commanded_m=Pair(*(sum(each.commanded_m for each in side) for side in (before, after))),
        max_linear_mps=Pair(*linear),
        max_angular_rps=Pair(*angular),
    )


def _largest(numbers: Iterable[float]) -> float:
    return max(numbers, default=0.0)
