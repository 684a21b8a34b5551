"""What a kernel commands in each drive: for how long, how far, how fast, and why the drive ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from robotctl.kernel.finite import finite_or_none
from robotctl.kernel.modes import Mode
from robotctl.kernel.state import State
from robotctl.kernel.types import DriveEnded, Effect
from robotctl.kernel.units import NS_PER_S


@dataclass(slots=True)
class DriveCommands:
    """The commands of one kernel in one drive, which is first seen at `begin_ns` (steady)."""

    begin_ns: int
    in_mode_ns: dict[Mode, int] = field(default_factory=dict)
    commanded_m: float = 0.0
    largest_mps: float = 0.0
    largest_rps: float = 0.0
    end: DriveEnded | None = None
    end_mode: Mode | None = None
    has_path: bool = True

    def as_object(self) -> dict[str, Any]:
        """Return what the kernel decided, as JSON values."""
        end = self.end
        return {
            "modes_s": {mode.name: ns / NS_PER_S for mode, ns in self.in_mode_ns.items()},
            "commanded_m": self.commanded_m,
            "max_linear_mps": self.largest_mps,
            "max_angular_rps": self.largest_rps,
            "duration_s": None if end is None else finite_or_none(end.report.duration_s),
            "completed": None if end is None else end.completed,
            "ended": None if end is None else end.reason,
            "cause": None if end is None or end.cause is None else end.cause.value,
            "end_mode": None if self.end_mode is None else self.end_mode.name,
        }

    def measured(self) -> dict[str, Any] | None:
        """Return what was measured until the end, as JSON values; None before the end."""
        if self.end is None:
            return None
        report = self.end.report if self.has_path else self.end.report.without_errors()
        return {
            "laps": report.laps,
            "distance_m": finite_or_none(report.distance_m),
            "rms_error_m": finite_or_none(report.cross_track_rms_m),
            "max_error_m": finite_or_none(report.cross_track_max_m),
        }


class DrivesOfKernel:
    """The drives of one kernel by the ids of the requests that began them."""

    def __init__(self) -> None:
        self.drives: dict[int, DriveCommands] = {}

    def add(
        self, before: State, after: State, effects: Iterable[Effect], t_ns: int, elapsed_ns: int
    ) -> None:
        """Take a step at `t_ns` from one state to another, `elapsed_ns` after the one before."""
        drive, following = before.drive, after.drive
        if drive is not None:
            self._add_time(self._of(drive.request_id, t_ns - elapsed_ns), before, elapsed_ns)
        if following is not None:
            if drive is not None and drive.request_id == following.request_id:
                return
            self._of(following.request_id, t_ns)
        for effect in effects:
            if isinstance(effect, DriveEnded):
                ended = self._of(effect.request_id, t_ns)
                ended.end, ended.end_mode = effect, after.mode
                ended.has_path = drive is None or bool(drive.path.segments)

    def _of(self, request_id: int, begin_ns: int) -> DriveCommands:
        found = self.drives.get(request_id)
        if found is None:
            found = self.drives[request_id] = DriveCommands(begin_ns)
        return found

    @staticmethod
    def _add_time(drive: DriveCommands, state: State, elapsed_ns: int) -> None:
        linear, angular = abs(state.command.linear), abs(state.command.angular)
        drive.in_mode_ns[state.mode] = drive.in_mode_ns.get(state.mode, 0) + elapsed_ns
        drive.commanded_m += linear * elapsed_ns / NS_PER_S
        drive.largest_mps = max(drive.largest_mps, linear)
        drive.largest_rps = max(drive.largest_rps, angular)


def drives_of_both(
    recorded: Mapping[int, DriveCommands], other: Mapping[int, DriveCommands], begin_ns: int
) -> list[dict[str, Any]]:
    """Return the drives of two kernels beside each other, as JSON values, in their order.

    A drive is `None` on the side that did not begin it. `measured` is what the robot did under the
    recorded commands: how it would have followed others is not known.
    """

    def began_ns(request_id: int) -> int:
        sides = recorded.get(request_id), other.get(request_id)
        return min(each.begin_ns for each in sides if each is not None)

    found = []
    for number, request_id in enumerate(sorted(recorded.keys() | other.keys(), key=began_ns), 1):
        mine, theirs = recorded.get(request_id), other.get(request_id)
        found.append(
            {
                "drive": number,
                "request_id": request_id,
                "after_s": (began_ns(request_id) - begin_ns) / NS_PER_S,
                "measured": None if mine is None else mine.measured(),
                "recorded": None if mine is None else mine.as_object(),
                "what_if": None if theirs is None else theirs.as_object(),
            }
        )
    return found
