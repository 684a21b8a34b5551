"""The control loop: at each tick, what was heard since the one before, then a decision."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.inputs import ForeignCommands
from robotctl.daemon.control.watchdog import Watchdog
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import FaultReported, LoopStalled, Tick
from robotctl.ros.executor import Tick as LoopTick
from robotctl.ros.executor import Ticker
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

_log = logging.getLogger(__name__)

LOOKS_ENOUGH_HZ: Final = 50.0
"""A control rate from which the ticks look at the heard commands often enough..."""

COMMAND_LATENCY_S: Final = 0.01
"""...and how long these are collected at a lower rate."""


class ControlLoop:
    """Ticks the kernel at the control rate, and feeds the watchdog."""

    def __init__(
        self, rate_hz: float, control: Control, watchdog: Watchdog, velocity: VelocityPublisher
    ) -> None:
        """Look at the commands of others on the topic of `velocity`."""
        self._rate_hz = rate_hz
        self._control = control
        self._watchdog = watchdog
        foreign = ForeignCommands(
            velocity.gid,
            velocity.name_of,
            lambda: control.state.mode is Mode.MOVING,
            control.dispatch,
        )
        self.look_at_commands = velocity.monitor(
            foreign.heard, None if rate_hz >= LOOKS_ENOUGH_HZ else COMMAND_LATENCY_S
        )

    async def run(self, look_at_odometry: Callable[[], None]) -> None:
        """Decide at each tick, until cancelled."""

        def decide(tick: LoopTick) -> None:
            self.look_at_commands()
            look_at_odometry()
            self._control.dispatch(Tick(tick.t_ns, tick.missed))
            self._watchdog.ping()

        await Ticker(self._rate_hz).run(decide)


def urgent_event(watchdog: Watchdog) -> LoopStalled | FaultReported | None:
    """Return what the watchdog did or found since the last call, and log a stall."""
    event = watchdog.take()
    if isinstance(event, LoopStalled):
        _log.warning("the loop stalled for %.2f s: %s", event.stalled_s, event.detail)
    return event
