"""One process a role, in a world: simulated robot, gate and owner of the mode."""

from __future__ import annotations

import signal
import subprocess
from typing import Any

from tests.support.waiting import DEADLINE_S, until
from tests.support.world import World

PATIENT_GATE = ("-p", "silence_s:=10.0")
PATIENT_OWNER = (
    *("-p", "standalone:=false", "-p", "max_tick_gap_s:=5.0"),
    *("-p", "odometry.timeout_s:=10.0", "-p", "battery.timeout_s:=60.0"),
    *("-p", "recording.clip_before_s:=0.0"),
)


class Arrangement:
    """The processes of one robot; `robot` names it, and its namespace but for the default one."""

    def __init__(self, world: World, robot: str = "robot") -> None:
        self.world = world
        self.robot = robot
        self._running: list[subprocess.Popen[str]] = []
        self._remap = () if robot == "robot" else ("-r", f"__ns:=/{robot}")

    def start(self) -> None:
        """Start all three, and wait until the robot can be moved."""
        self.sim()
        self.gate(*PATIENT_GATE)
        self.owner(*PATIENT_OWNER)
        self.until_complete()

    def sim(self, *arguments: str) -> subprocess.Popen[str]:
        """Start the simulated robot."""
        process = self.world.spawn("sim", "--robot", self.robot, *arguments)
        self._running.append(process)
        return process

    def gate(self, *arguments: str) -> subprocess.Popen[str]:
        """Start the gate."""
        return self._role("velocity_publisher", *arguments)

    def owner(self, *arguments: str) -> subprocess.Popen[str]:
        """Start the owner of the mode."""
        return self._role("mode_service", *arguments)

    def end(self) -> list[int]:
        """Interrupt all that still run, at once, as a terminal does; return their exit codes."""
        running = [each for each in self._running if each.poll() is None]
        for process in running:
            process.send_signal(signal.SIGINT)
        return [process.wait(timeout=2 * DEADLINE_S) for process in running]

    def set_mode(self, mode: str) -> bool:
        """Request a mode; return whether it was granted."""
        return self.world.here("set-mode", mode, "--robot", self.robot).exit_code == 0

    def status(self) -> Any:
        """Return the owner's status."""
        return self.world.status(self.robot)

    def until_complete(self) -> None:
        """Wait until robot, gate and owner know each other, and the robot moves."""
        until(lambda: self.set_mode("idle") and self.set_mode("moving"))

    def _role(self, name: str, *arguments: str) -> subprocess.Popen[str]:
        process = self.world.role(name, "--ros-args", *self._remap, *arguments)
        self._running.append(process)
        return process
