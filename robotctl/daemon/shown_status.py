"""`/robot_status` as others see it: published each second, and at each change of the mode."""

from __future__ import annotations

import asyncio
from math import nan

from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.kernel.modes import Mode
from robotctl.kernel.state import is_level
from robotctl.ros.nodes.mode_service import ModeService, Shown
from robotctl.ros.nodes.publishers import CommandLock

SHOW_PERIOD_S = 1.0


class ShownStatus:
    """Publishes the mode, the battery level, whether odometry is fresh, and the lock for others."""

    def __init__(
        self, modes: ModeService, control: Control, report: RobotReport, lock: CommandLock
    ) -> None:
        self._lock = lock
        self._modes = modes
        self._control = control
        self._report = report

    def show(self, mode: Mode) -> None:
        """Publish now."""
        self._lock.show(mode)
        level = self._control.state.health.battery_level
        self._modes.publish(
            Shown(mode, level if is_level(level) else nan, self._report.is_connected())
        )

    async def run(self) -> None:
        """Publish each second."""
        while True:
            self.show(self._control.state.mode)
            await asyncio.sleep(SHOW_PERIOD_S)
