"""The start conditions in words: what must hold before the robot may move."""

from __future__ import annotations

from typing import assert_never

from robotctl.kernel.types import Cause


def condition_of(cause: Cause) -> str:
    """Return what must hold so that `cause` does not apply."""
    match cause:
        case Cause.OPERATOR_STOP | Cause.OPERATOR_ERROR:
            return "no stop of an operator"
        case Cause.ESTOP_PRESSED:
            return "emergency stop inputs released"
        case Cause.ESTOP_SILENT:
            return "required emergency stop inputs heard"
        case Cause.BATTERY_LOW:
            return "battery above its stop level"
        case Cause.BATTERY_UNKNOWN:
            return "battery level known"
        case Cause.TASK_DIED:
            return "all parts of the daemon work"
        case Cause.LOOP_STALLED:
            return "control loop runs"
        case Cause.TICK_OVERRUN:
            return "control ticks on time"
        case Cause.RECORDER_FAILED:
            return "recorder works"
        case Cause.UNREACHABLE:
            return "control socket reachable"
        case Cause.DAEMON_ENDS:
            return "daemon is not ending"
        case Cause.GATE_LOST:
            return "one gate passes the commands on"
        case Cause.NOT_ACTIVE:
            return "the node that gates motion is active"
        case Cause.ODOMETRY_WRONG:
            return "odometry plausible"
        case Cause.ODOMETRY_LOST:
            return "odometry fresh"
        case Cause.ODOMETRY_CONTRADICTED:
            return "odometry not contradicted"
        case Cause.SECOND_ODOMETRY:
            return "one publisher of odometry"
        case Cause.TRACKING_LOST:
            return "robot on its path"
        case Cause.FENCE_LEFT:
            return "robot inside its fence"
        case Cause.OBSTACLE_NEAR:
            return "path free"
        case Cause.SCAN_LOST:
            return "required scan heard"
        case Cause.BUMPER_PRESSED:
            return "bumper free"
        case Cause.TILTED:
            return "robot upright"
        case Cause.BASE_FAULT:
            return "no error in the base's diagnostics"
        case Cause.INPUT_LOST:
            return "required safety inputs heard"
        case Cause.FOREIGN_PUBLISHER:
            return "no other publisher of commands"
        case Cause.COMMAND_UNHEARD:
            return "a node takes the commands"
        case Cause.COMMAND_TYPES_MIXED:
            return "one type of command wanted"
        case Cause.TOPIC_TROUBLE:
            return "topics of others as expected"
        case _:
            assert_never(cause)
