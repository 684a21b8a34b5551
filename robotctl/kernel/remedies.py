"""What an operator can do when the robot may not move.

A remedy is only a name; `robotctl.ipc.advice` returns its text, with the commands for one robot.
"""

from __future__ import annotations

from enum import Enum


class Remedy(Enum):
    """One thing that the operator can do."""

    RELEASE_STOP = "release the emergency stop"
    CLEAR_ERROR = "clear the error"
    RESET = "reset"
    STOP_FIRST = "stop first"
    STOP_OR_REPLACE = "stop first or replace the drive"
    CHARGE_BATTERY = "charge the battery"
    CHECK_BATTERY_TOPIC = "check the battery topic"
    READ_LOG_AND_RESTART = "read the log and restart"
    RESTART = "restart"
    RESTORE_SOCKET_FOLDER = "restore the socket folder"
    START_DAEMON = "start the daemon"
    FREE_PROCESSOR = "free the processor"
    FREE_PROCESSOR_OR_LOWER_RATE = "free the processor or lower the rate"
    CHECK_ODOMETRY_SOURCE = "check the odometry source"
    CHECK_ODOMETRY_IS_PUBLISHED = "check that odometry is published"
    STOP_ONE_ODOMETRY_PUBLISHER = "stop one odometry publisher"
    RELEASE_BUTTON = "release the button"
    CHECK_INPUT = "check the safety input"
    FREE_ROBOT = "free the robot"
    BRING_BACK = "bring the robot back"
    CLEAR_PATH = "clear the path"
    CHECK_SCAN = "check the scan"
    CHECK_BASE = "check the base"
    CHECK_WHEELS = "check the wheels"
    STOP_COMMAND_PUBLISHER = "stop the other command publisher"
    START_BASE = "start the base"
    ACTIVATE = "activate the node"
    ASK_HERE = "ask on this host"
    WAIT_FOR_LEASE = "wait for the lease"
    SET_COMMAND_TYPE = "set the command's type"
    CHECK_TOPIC = "check the topic's publisher"


RESETTING = frozenset({Remedy.RELEASE_STOP, Remedy.CLEAR_ERROR, Remedy.RESET})
"""The remedies that are a reset. After another remedy, a reset is still needed."""
