"""Faults of the simulated robot, each for a while: what they do, and how long they last."""

from __future__ import annotations

from enum import Enum

from robotctl.kernel.geometry import Pose

JUMP_M = 1.0
"""How far the reported pose jumps along x, and back at the end."""

BROWNOUT_LEVEL = 0.1
"""The highest reported level while the supply is too weak."""

MAX_FAULT_S = 60.0


class SimFault(Enum):
    """What can go wrong with the simulated robot.

    ODOM_LOST: it publishes no odometry. ODOM_JUMP: its reported pose jumps by `JUMP_M`. SLIP: it
    stays where it is whatever the drives do. HANG: it takes no command and publishes nothing, and
    its drives keep the last command until its own timeout. BROWNOUT: its drives have no power, and
    the level is at most `BROWNOUT_LEVEL`.
    """

    ODOM_LOST = "odom-lost"
    ODOM_JUMP = "odom-jump"
    SLIP = "slip"
    HANG = "hang"
    BROWNOUT = "brownout"


class Faults:
    """The simulated faults that are active, and how long each one still lasts."""

    def __init__(self) -> None:
        self._left_s: dict[SimFault, float] = {}

    def __contains__(self, fault: SimFault) -> bool:
        left_s = self._left_s
        return bool(left_s) and fault in left_s  # nearly always none: no member is hashed then

    def begin(self, fault: SimFault, for_s: float) -> None:
        """Begin a fault, or change the rest of its time."""
        self._left_s[fault] = for_s

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, and end the faults whose time is over."""
        self._left_s = {
            fault: left_s - dt_s for fault, left_s in self._left_s.items() if left_s > dt_s
        }

    def reported_pose(self, pose: Pose) -> Pose:
        """Return the pose that is reported for this one."""
        if SimFault.ODOM_JUMP in self:
            return Pose(pose.x + JUMP_M, pose.y, pose.theta)
        return pose

    def reported_level(self, level: float) -> float:
        """Return the battery level that is reported for this one."""
        return min(level, BROWNOUT_LEVEL) if SimFault.BROWNOUT in self else level
