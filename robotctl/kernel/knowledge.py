"""The part of the kernel that takes what it learns into its state."""

from __future__ import annotations

from dataclasses import replace
from math import inf

from robotctl.kernel.battery import counts_in_percent, level_of
from robotctl.kernel.health import Scan, Stalls
from robotctl.kernel.modes import Mode
from robotctl.kernel.obstacles import distance_ahead, farthest_m, free_beside_m, is_free
from robotctl.kernel.parameter_control import ParameterControl
from robotctl.kernel.safety import RULE_OF, Finding
from robotctl.kernel.types import ZERO, BatteryReceived, Cause, LoopStalled


class Knowledge(ParameterControl):
    """What was learned about robot, battery, scan and loop; a fault among it is raised at once."""

    def _battery(self, event: BatteryReceived) -> None:
        before, scale = self.state.health.battery_in_percent, self.params.battery.scale
        in_percent = counts_in_percent(event.level, before, scale)
        self._learn(
            event.t_ns,
            battery_level=level_of(event.level, in_percent),
            battery_t_ns=event.t_ns,
            battery_in_percent=in_percent,
        )

    def _looked_ahead(self, t_ns: int, sectors: tuple[float, ...]) -> Scan:
        """Return a scan with the distance to what is in the path of the present command."""
        ahead_m = distance_ahead(sectors, self.state.command, self.params.scan, self._reach_m())
        return Scan(t_ns, sectors, min(sectors, default=inf), ahead_m)

    def _look_again(self, scan: Scan) -> None:
        """Look at the last scan again: the command has changed."""
        command, params, reach_m = self.state.command, self.params.scan, self._reach_m()
        ahead_m = inf
        if not scan.nearest_m > farthest_m(params, reach_m):  # so that NaN is looked at
            far_m = self._reach_at_m(self.params.limits.linear_mps)
            free_m = free_beside_m(scan.sectors, params, far_m)
            if not is_free(free_m, command, params, reach_m):
                ahead_m = distance_ahead(scan.sectors, command, params, reach_m)
        if ahead_m != scan.ahead_m:
            scan = Scan(scan.t_ns, scan.sectors, scan.nearest_m, ahead_m)
            self.state = replace(self.state, health=replace(self.state.health, scan=scan))

    def _reach_m(self) -> float:
        """Return how far ahead of the robot nothing may be: stop and braking distance."""
        return self._reach_at_m(self.state.command.linear)

    def _reach_at_m(self, speed_mps: float) -> float:
        params = self.params
        braking_m = speed_mps * speed_mps / (2.0 * params.limits.linear_accel_mps2)
        return params.scan.stop_distance_m + braking_m

    def _stalled(self, event: LoopStalled) -> None:
        """Continue from the zeros of the watchdog; raise a fault if the stall was too long."""
        state, limit_s = self.state, self.params.max_tick_gap_s
        stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, event.detail)
        drive = None if state.drive is None else state.drive.from_standstill()
        health = replace(state.health, stalls=stalls)
        self.state = replace(state, command=ZERO, tick_t_ns=event.t_ns, health=health, drive=drive)
        if state.mode is Mode.MOVING and not event.stalled_s <= limit_s:
            detail = f"the control loop stalled for {event.stalled_s:.2f} s ({event.detail})"
            self._stop_for(Finding(RULE_OF[Cause.LOOP_STALLED], detail))

    def _learn(self, t_ns: int, **changes: object) -> None:
        self._notice_gap(t_ns)
        self.state = replace(self.state, health=replace(self.state.health, **changes))  # type: ignore[arg-type]
        self._raise_fault(t_ns)

    def _reported_without(self, cause: Cause) -> tuple[tuple[Cause, str], ...]:
        return tuple(entry for entry in self.state.health.reported if entry[0] is not cause)
