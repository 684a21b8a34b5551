"""The simulated differential-drive robot, without a clock, a bus or ROS."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import fsum, isfinite
from random import Random

from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.ranges import Change, bounded, setting
from robotctl.kernel.trigonometry import direction, exp
from robotctl.kernel.types import ZERO, Twist

JUMP_M = 1.0
"""The jump of the reported pose along x in an ODOM_JUMP; at its end, it jumps back."""

BROWNOUT_LEVEL = 0.1
"""The highest battery level that is reported during a BROWNOUT."""

MAX_FAULT_S = 60.0


class SimFault(Enum):
    """A fault of the simulated robot."""

    ODOM_LOST = "odom-lost"
    """The robot publishes no odometry."""
    ODOM_JUMP = "odom-jump"
    """The reported pose jumps by `JUMP_M` until the fault ends."""
    SLIP = "slip"
    """The robot does not move, though its wheels turn."""
    HANG = "hang"
    """The robot publishes nothing, ignores commands, and stops after `command_timeout_s`."""
    BROWNOUT = "brownout"
    """The drives have no power, and the reported battery level is at most `BROWNOUT_LEVEL`."""


class Faults:
    """The active simulated faults, with their remaining times."""

    def __init__(self) -> None:
        self._left_s: dict[SimFault, float] = {}

    def __contains__(self, fault: SimFault) -> bool:
        left_s = self._left_s
        return bool(left_s) and fault in left_s  # usually empty: saves the hash of the member

    def begin(self, fault: SimFault, for_s: float) -> None:
        """Make `fault` active for `for_s` from now on."""
        self._left_s[fault] = for_s

    def advance(self, dt_s: float) -> None:
        """Reduce the time left of each fault by `dt_s`, and end the faults at 0."""
        self._left_s = {
            fault: left_s - dt_s for fault, left_s in self._left_s.items() if left_s > dt_s
        }

    def reported_pose(self, pose: Pose) -> Pose:
        """Return `pose` as the robot reports it: shifted by JUMP_M along x during an ODOM_JUMP."""
        if SimFault.ODOM_JUMP in self:
            return Pose(pose.x + JUMP_M, pose.y, pose.theta)
        return pose

    def reported_level(self, level: float) -> float:
        """Return `level` as the robot reports it: at most BROWNOUT_LEVEL during a BROWNOUT."""
        return min(level, BROWNOUT_LEVEL) if SimFault.BROWNOUT in self else level


@dataclass(frozen=True, slots=True)
class SimParams:
    """The imperfections of the simulated robot.

    Actuation factors scale the true motion, odometry factors only the reported one. At each step,
    every factor is multiplied by a random number of mean 1, whose standard deviation is
    `actuation_noise` or `odometry_noise`.
    """

    lag_s: float = bounded(0.08, 0.0, 2.0, "s", "time constant of the drives", Change.START)
    linear_accel_mps2: float = bounded(
        2.0, 0.01, 50.0, "m/s^2", "largest change of its speed", Change.START
    )
    angular_accel_rps2: float = bounded(
        8.0, 0.01, 100.0, "rad/s^2", "largest change of its turning rate", Change.START
    )
    command_timeout_s: float = bounded(
        0.5, 0.05, 10.0, "s", "time without a command after which it stops", Change.START
    )
    actuation_linear_factor: float = bounded(
        0.98, 0.1, 2.0, "", "driven per commanded distance", Change.START
    )
    actuation_angular_factor: float = bounded(
        1.02, 0.1, 2.0, "", "turned per commanded angle", Change.START
    )
    actuation_noise: float = bounded(0.02, 0.0, 1.0, "", "deviation of both factors", Change.START)
    odometry_linear_factor: float = bounded(
        1.005, 0.1, 2.0, "", "reported per driven distance", Change.START
    )
    odometry_angular_factor: float = bounded(
        0.995, 0.1, 2.0, "", "reported per turned angle", Change.START
    )
    odometry_noise: float = bounded(0.005, 0.0, 1.0, "", "deviation of both factors", Change.START)
    battery_start: float = bounded(1.0, 0.0, 1.0, "", "level at the start", Change.START)
    battery_life_s: float = bounded(7200.0, 1.0, 1e6, "s", "time from full to empty", Change.START)
    odometry_rate_hz: float = bounded(50.0, 1.0, 1000.0, "Hz", "rate of the odometry", Change.START)
    seed: int = setting(1, "seed of the noise", Change.START)


class Robot:
    """The simulated robot with its true pose `truth` and its reported pose `odometry`."""

    def __init__(self, params: SimParams) -> None:
        self._params = params
        self._random = Random(params.seed)
        self._command = ZERO
        self._command_age_s = 0.0
        self._wheels = ZERO
        self.truth: Pose = ORIGIN
        self.odometry: Pose = ORIGIN
        self.measured: Twist = ZERO
        self.battery = params.battery_start
        self.faults = Faults()

    def resume(self, pose: Pose, measured: Twist, command: Twist) -> None:
        """Continue from `pose` with the reported velocity `measured` and the command `command`."""
        params = self._params
        self.truth = self.odometry = pose
        self.measured = measured
        self._command = command
        self._wheels = Twist(
            measured.linear / (params.actuation_linear_factor * params.odometry_linear_factor),
            measured.angular / (params.actuation_angular_factor * params.odometry_angular_factor),
        )

    def command(self, twist: Twist) -> None:
        """Follow `twist` until the next command or the command timeout; ignore it during a HANG."""
        if SimFault.HANG in self.faults:
            return
        finite = isfinite(twist.linear) and isfinite(twist.angular)
        self._command = twist if finite else ZERO
        self._command_age_s = 0.0

    def advance(self, dt_s: float) -> None:
        """Advance the simulation of robot, faults and battery by `dt_s` seconds."""
        params = self._params
        self.faults.advance(dt_s)
        self._command_age_s += dt_s
        is_driven = self._command_age_s <= params.command_timeout_s
        target = self._command if is_driven and SimFault.BROWNOUT not in self.faults else ZERO
        lag = 1.0 - exp(-dt_s / params.lag_s) if params.lag_s else 1.0
        linear = _follow(self._wheels.linear, target.linear, lag, params.linear_accel_mps2 * dt_s)
        angular = _follow(
            self._wheels.angular, target.angular, lag, params.angular_accel_rps2 * dt_s
        )
        self._wheels = Twist(linear, angular)
        moved = Twist(
            linear * params.actuation_linear_factor * self._jitter(params.actuation_noise),
            angular * params.actuation_angular_factor * self._jitter(params.actuation_noise),
        )
        if SimFault.SLIP in self.faults:
            moved = ZERO
        self.measured = Twist(
            moved.linear * params.odometry_linear_factor * self._jitter(params.odometry_noise),
            moved.angular * params.odometry_angular_factor * self._jitter(params.odometry_noise),
        )
        self.truth = _integrate(self.truth, moved, dt_s)
        self.odometry = _integrate(self.odometry, self.measured, dt_s)
        self.battery = max(0.0, self.battery - dt_s / params.battery_life_s)

    def _jitter(self, deviation: float) -> float:
        """Return a nearly normal random factor of mean 1."""
        return 1.0 + deviation * (fsum(self._random.random() for _ in range(12)) - 6.0)


STANDSTILL = 1e-4
"""Below this speed [m/s, rad/s] friction stops a robot whose command is zero."""


def _follow(speed: float, target: float, lag: float, max_step: float) -> float:
    step = (target - speed) * lag
    following = speed + min(max(step, -max_step), max_step)
    return 0.0 if target == 0.0 and abs(following) < STANDSTILL else following


def _integrate(pose: Pose, velocity: Twist, dt_s: float) -> Pose:
    middle = pose.theta + 0.5 * velocity.angular * dt_s
    c, s = direction(middle)
    way_m = velocity.linear * dt_s
    theta = wrap_angle(pose.theta + velocity.angular * dt_s)
    return Pose(pose.x + way_m * c, pose.y + way_m * s, theta)
