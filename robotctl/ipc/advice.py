"""Texts for the operator of one robot: what is wrong, what to do, and the commands for it.

The kernel knows neither robot names nor commands: its decisions contain remedies as data.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple, assert_never

from robotctl.ipc.client import command_for
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import Cause


def condition_of(cause: Cause) -> str:
    """Return the start condition that is not met while `cause` applies, such as "path free"."""
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


_COMMAND = re.compile(
    r"\brobotctl (logs|reset|set-mode idle|start|status|stop)\b(?! \(uid | --robot )"
)
"""Matches a command without `--robot`, but not a requester's name, after which ` (uid` stands."""


class Advice(NamedTuple):
    """`cause` says what is wrong, `cure` what to do about it, or "" if there is no remedy."""

    cause: str
    cure: str

    @property
    def sentence(self) -> str:
        """Cause and cure in one line, or the cause alone if there is no cure."""
        return f"{self.cause}: {self.cure}" if self.cure else self.cause


def advice(text: str, remedies: Iterable[Remedy], robot: str) -> Advice:
    """Return `text` as the cause and `remedies` as the cure, for the operator of `robot`."""
    cure = ", then ".join(cure_of(remedy, robot) for remedy in remedies)
    return Advice(for_robot(text, robot), cure)


def for_robot(text: str, robot: str) -> str:
    """Return `text` with `--robot NAME` after each command; unchanged for the default robot."""
    return _COMMAND.sub(lambda match: command_for(robot, match[1]), text)


def cure_of(remedy: Remedy, robot: str) -> str:
    """Return the words that tell the operator of `robot` what to do, with complete commands."""
    logs, reset = command_for(robot, "logs"), command_for(robot, "reset")
    start, stop = command_for(robot, "start"), command_for(robot, "stop")
    match remedy:
        case Remedy.RELEASE_STOP:
            return f"release it: {reset}"
        case Remedy.CLEAR_ERROR:
            return f"clear it: {reset}"
        case Remedy.RESET:
            return reset
        case Remedy.STOP_FIRST:
            return f"stop it first ({command_for(robot, 'set-mode idle')})"
        case Remedy.STOP_OR_REPLACE:
            return f"{cure_of(Remedy.STOP_FIRST, robot)}, or use --replace"
        case Remedy.CHARGE_BATTERY:
            return "charge the battery"
        case Remedy.CHECK_BATTERY_TOPIC:
            return (
                "check the battery topic, set battery.scale to 100 for a gauge that counts in "
                'percent, or battery.topic to "" for a robot without a battery'
            )
        case Remedy.READ_LOG_AND_RESTART:
            return f"see {logs}, then restart: {stop}, {start}"
        case Remedy.RESTART:
            return f"restart after that: {stop}, {start}"
        case Remedy.RESTORE_SOCKET_FOLDER:
            return "give the control socket its folder back"
        case Remedy.START_DAEMON:
            return f"start it again: {start}"
        case Remedy.FREE_PROCESSOR:
            return f"free the processor, or see {logs} for what held it up"
        case Remedy.FREE_PROCESSOR_OR_LOWER_RATE:
            return f"free the processor, lower rate_hz, or see {logs} for what held it up"
        case Remedy.CHECK_ODOMETRY_SOURCE:
            return "check the odometry source"
        case Remedy.CHECK_ODOMETRY_IS_PUBLISHED:
            status = command_for(robot, "status")
            return f"check that the robot publishes odometry ({status} lists the topics)"
        case Remedy.STOP_ONE_ODOMETRY_PUBLISHER:
            return "stop one of the two publishers"
        case Remedy.RELEASE_BUTTON:
            return "release the button"
        case Remedy.CHECK_INPUT:
            return "check the node that publishes it, or its key inputs.*.use"
        case Remedy.FREE_ROBOT:
            return "look at the robot, and free it by hand"
        case Remedy.BRING_BACK:
            return "bring the robot back by hand, or start robotctl again where it may drive"
        case Remedy.CLEAR_PATH:
            return "clear the path, or turn the robot by hand"
        case Remedy.CHECK_SCAN:
            return "check the scanner, or scan.use"
        case Remedy.CHECK_BASE:
            return "see what the robot's base reports on /diagnostics"
        case Remedy.CHECK_WHEELS:
            return "check wheels and odometry, or lower the speed"
        case Remedy.STOP_COMMAND_PUBLISHER:
            return "stop the other publisher"
        case Remedy.ACTIVATE:
            change = "service call mode_service/change_state '{transition: {label: %s}}'"
            activate = command_for(robot, change % "activate")
            return f"activate it: {activate} (configure comes first; finalized cannot be undone)"
        case Remedy.START_BASE:
            return (
                "start the robot's base; if it runs, start robotctl again (it chooses Twist or "
                "TwistStamped at its start), or check command.topic and command.stamped"
            )
        case Remedy.ASK_HERE:
            return "ask on the robot's own computer, or start with remote_motion: true"
        case Remedy.WAIT_FOR_LEASE:
            idle = command_for(robot, "set-mode idle")
            return f"wait until it is released; {idle} and {command_for(robot, 'estop')} still stop"
        case Remedy.SET_COMMAND_TYPE:
            return "set command.stamped to true for TwistStamped, or to false for Twist"
        case Remedy.CHECK_TOPIC:
            return "check the node that publishes it, recording.expected_rates, or on_topic_trouble"
