"""The roles that receive battery, scan, safety inputs and guarded velocities."""

from __future__ import annotations

from robotctl.daemon.control.inputs import Inputs
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import Use
from robotctl.ros.messages.command_type import CommandType
from robotctl.ros.nodes.input_subscribers import (
    BatterySubscriber,
    GuardSubscriber,
    SafetyInputs,
    ScanSubscriber,
)
from robotctl.ros.session import Session


def create_input_roles(
    session: Session, params: KernelParams, robot: str, inputs: Inputs, command: CommandType
) -> None:
    """Subscribe to each input that is configured, and pass it to `inputs`."""
    if params.battery.topic:
        BatterySubscriber(session, params.battery.topic, inputs.battery)
    if params.scan.use is not Use.OFF:
        ScanSubscriber(session, params.scan.topic, inputs.scan)
    if params.guard:
        GuardSubscriber(session, params.guard_topic, command, inputs.guarded_command)
    SafetyInputs(session, params.inputs, robot, inputs.safety_input)
