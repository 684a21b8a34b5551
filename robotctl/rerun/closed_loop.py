"""A closed loop of kernel and simulated robot on virtual time, without clock and ROS."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.state import full_level, is_level
from robotctl.kernel.types import (
    BatteryReceived,
    Effect,
    Event,
    Odometry,
    OdomReceived,
    PublishTwist,
    Tick,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.journal_values import decide
from robotctl.sim.robot import Robot, SimParams

TICK_AFTER_ODOMETRY_NS = 1_000_000
"""Ticks follow odometry by this time: tracking is best with fresh odometry."""


@dataclass(frozen=True, slots=True)
class Start:
    """The initial odometry and battery level (0..1), used where the kernel does not know them."""

    odometry: Odometry | None = None
    battery: float | None = None


def closed_loop(
    kernel: Kernel,
    sim: SimParams,
    requests: Iterable[Event],
    begin_ns: int,
    start: Start = Start(),
) -> Iterator[tuple[Event, tuple[Effect, ...]]]:
    """Yield every event with its effects from `begin_ns` (steady) on, without end.

    `requests` are ordered by time, and each reaches the kernel at its `t_ns`. The robot begins with
    pose, velocity and battery level as the kernel knows them, or else with those of `start`.

    Raises:
        UnreadableFile: The kernel cannot continue from its state.
    """
    robot = Robot(sim)
    health = kernel.state.health
    known = health.odometry or start.odometry
    if known is not None:
        robot.resume(known.pose, known.velocity, kernel.state.command)
    level = health.battery_level if is_level(health.battery_level) else start.battery
    if is_level(level):
        robot.battery = min(level, 1.0)
    stamp_ns = health.odometry_stamp_ns - begin_ns
    source = health.odometry_sources.followed
    full = 100.0 if health.battery_in_percent else full_level(kernel.params.battery.scale)
    odometry_ns = round(NS_PER_S / sim.odometry_rate_hz)
    tick_ns = round(NS_PER_S / kernel.params.rate_hz)
    next_odometry_ns = next_battery_ns = begin_ns
    next_tick_ns = begin_ns + TICK_AFTER_ODOMETRY_NS
    asked = iter(requests)
    request = next(asked, None)
    event: Event
    while True:
        t_ns = min(next_odometry_ns, next_tick_ns, next_battery_ns)
        if request is not None and request.t_ns < t_ns:
            event, request = request, next(asked, None)
        elif t_ns == next_odometry_ns:
            next_odometry_ns += odometry_ns
            robot.advance(1.0 / sim.odometry_rate_hz)
            measured = Odometry(robot.odometry, robot.measured, stamp_ns + t_ns)
            event = OdomReceived(t_ns, measured, source)
        elif t_ns == next_battery_ns:
            next_battery_ns += NS_PER_S
            event = BatteryReceived(t_ns, full * robot.battery)
        else:
            next_tick_ns += tick_ns
            event = Tick(t_ns)
        effects = decide(kernel, event)
        for effect in effects:
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
        yield event, effects
