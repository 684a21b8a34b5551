"""Texts for the operator of one robot, with problems, remedies and commands."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from robotctl.ipc.client import command_for
from robotctl.kernel.types import Cause, Remedy

CONDITIONS: Final = {
    Cause.OPERATOR_STOP: "no stop of an operator",
    Cause.OPERATOR_ERROR: "no stop of an operator",
    Cause.ESTOP_PRESSED: "emergency stop inputs released",
    Cause.ESTOP_SILENT: "required emergency stop inputs heard",
    Cause.BATTERY_LOW: "battery above its stop level",
    Cause.BATTERY_UNKNOWN: "battery level known",
    Cause.TASK_DIED: "all parts of the daemon work",
    Cause.LOOP_STALLED: "control loop runs",
    Cause.TICK_OVERRUN: "control ticks on time",
    Cause.RECORDER_FAILED: "recorder works",
    Cause.UNREACHABLE: "control socket reachable",
    Cause.DAEMON_ENDS: "daemon is not ending",
    Cause.NOT_ACTIVE: "the node that gates motion is active",
    Cause.ODOMETRY_WRONG: "odometry plausible",
    Cause.ODOMETRY_LOST: "odometry fresh",
    Cause.ODOMETRY_CONTRADICTED: "odometry not contradicted",
    Cause.SECOND_ODOMETRY: "one publisher of odometry",
    Cause.TRACKING_LOST: "robot on its path",
    Cause.FENCE_LEFT: "robot inside its fence",
    Cause.OBSTACLE_NEAR: "path free",
    Cause.SCAN_LOST: "required scan heard",
    Cause.BUMPER_PRESSED: "bumper free",
    Cause.TILTED: "robot upright",
    Cause.BASE_FAULT: "no error in the base's diagnostics",
    Cause.INPUT_LOST: "required safety inputs heard",
    Cause.FOREIGN_PUBLISHER: "no other publisher of commands",
    Cause.COMMAND_UNHEARD: "a node takes the commands",
    Cause.COMMAND_TYPES_MIXED: "one type of command wanted",
    Cause.TOPIC_TROUBLE: "topics of others as expected",
}
"""Cause -> the start condition that is violated by the cause, in words."""


_COMMAND = re.compile(
    r"\brobotctl (logs|reset|set-mode idle|start|status|stop)\b(?! \(uid | --robot )"
)
"""Matches a command without `--robot`, but not the user name `robotctl stop (uid 1000)`."""


class Advice(NamedTuple):
    """A problem (`cause`), and what the operator can do about it (`cure`, "" if nothing helps)."""

    cause: str
    cure: str

    @property
    def sentence(self) -> str:
        """Cause and cure in one line, or only the cause if there is no cure."""
        return f"{self.cause}: {self.cure}" if self.cure else self.cause


def advice(text: str, remedies: Iterable[Remedy], robot: str) -> Advice:
    """Return the problem `text` and the cures for `remedies`, with commands for `robot`."""
    cure = ", then ".join(cure_of(remedy, robot) for remedy in remedies)
    return Advice(for_robot(text, robot), cure)


def for_robot(text: str, robot: str) -> str:
    """Return `text` with `--robot NAME` after each command, or unchanged for the default robot."""
    return _COMMAND.sub(lambda match: command_for(robot, match[1]), text)


_COMMANDS: Final = {
    **{name: name for name in ("logs", "reset", "start", "stop", "status", "estop")},
    "idle": "set-mode idle",
    "activate": "service call mode_service/change_state '{transition: {label: activate}}'",
}

_CURES: Final = {
    Remedy.RELEASE_STOP: "release it: {reset}",
    Remedy.CLEAR_ERROR: "clear it: {reset}",
    Remedy.RESET: "{reset}",
    Remedy.STOP_FIRST: "stop it first ({idle})",
    Remedy.STOP_OR_REPLACE: "stop it first ({idle}), or use --replace",
    Remedy.CHARGE_BATTERY: "charge the battery",
    Remedy.CHECK_BATTERY_TOPIC: (
        "check the battery topic, set battery.scale to 100 for a gauge that counts in "
        'percent, or battery.topic to "" for a robot without a battery'
    ),
    Remedy.READ_LOG_AND_RESTART: "see {logs}, then restart: {stop}, {start}",
    Remedy.RESTART: "restart after that: {stop}, {start}",
    Remedy.RESTORE_SOCKET_FOLDER: "give the control socket its folder back",
    Remedy.START_DAEMON: "start it again: {start}",
    Remedy.FREE_PROCESSOR: "free the processor, or see {logs} for what held it up",
    Remedy.FREE_PROCESSOR_OR_LOWER_RATE: (
        "free the processor, lower rate_hz, or see {logs} for what held it up"
    ),
    Remedy.CHECK_ODOMETRY_SOURCE: "check the odometry source",
    Remedy.CHECK_ODOMETRY_IS_PUBLISHED: (
        "check that the robot publishes odometry ({status} lists the topics)"
    ),
    Remedy.STOP_ONE_ODOMETRY_PUBLISHER: "stop one of the two publishers",
    Remedy.RELEASE_BUTTON: "release the button",
    Remedy.CHECK_INPUT: "check the node that publishes it, or its key inputs.*.use",
    Remedy.FREE_ROBOT: "look at the robot, and free it by hand",
    Remedy.BRING_BACK: "bring the robot back by hand, or start robotctl again where it may drive",
    Remedy.CLEAR_PATH: "clear the path, or turn the robot by hand",
    Remedy.CHECK_SCAN: "check the scanner, or scan.use",
    Remedy.CHECK_BASE: "see what the robot's base reports on /diagnostics",
    Remedy.CHECK_WHEELS: "check wheels and odometry, or lower the speed",
    Remedy.STOP_COMMAND_PUBLISHER: "stop the other publisher",
    Remedy.ACTIVATE: "activate it: {activate} (configure comes first; finalized cannot be undone)",
    Remedy.START_BASE: (
        "start the robot's base; if it runs, start robotctl again (it chooses Twist or "
        "TwistStamped at its start), or check command.topic and command.stamped"
    ),
    Remedy.ASK_HERE: "ask on the robot's own computer, or start with remote_motion: true",
    Remedy.WAIT_FOR_LEASE: "wait until it is released; {idle} and {estop} still stop",
    Remedy.SET_COMMAND_TYPE: "set command.stamped to true for TwistStamped, or to false for Twist",
    Remedy.CHECK_TOPIC: (
        "check the node that publishes it, recording.expected_rates, or on_topic_trouble"
    ),
}


def cure_of(remedy: Remedy, robot: str) -> str:
    """Return `remedy` as advice to the operator, with complete commands for `robot`."""
    commands = {name: command_for(robot, words) for name, words in _COMMANDS.items()}
    return _CURES[remedy].format_map(commands)
