"""The safety inputs: what a message of each kind means, over ROS."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from math import isnan
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, Joy
from std_msgs.msg import Bool

from robotctl.kernel.safety_inputs import SafetyInput, SafetyInputParams, Use
from robotctl.messages.inputs import MAX_DIAGNOSES, Diagnoses
from robotctl.ros.nodes.input_subscribers import SafetyInputs
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]


def imu(x: float, w: float, covariance: float = 0.0) -> Imu:
    message = Imu()
    message.orientation.x, message.orientation.w = x, w
    message.orientation_covariance[0] = covariance
    return message


def diagnosis(name: str, level: bytes, hardware_id: str = "base") -> DiagnosticArray:
    status = DiagnosticStatus(name=name, level=level, message="hot", hardware_id=hardware_id)
    return DiagnosticArray(status=[status])


MESSAGES: list[tuple[SafetyInput, str, Any, float]] = [
    (SafetyInput.ESTOP, "estop_pressed", Bool(data=True), 1.0),
    (SafetyInput.ESTOP, "estop_pressed", Bool(data=False), 0.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[0, 1]), 1.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[1, 0]), 0.0),
    (SafetyInput.JOY, "joy", Joy(buttons=[1]), float("nan")),
    (SafetyInput.BUMPER, "bumper", Bool(data=True), 1.0),
    (SafetyInput.TILT, "imu", imu(0.0, 1.0), 0.0),
    (SafetyInput.TILT, "imu", imu(0.5**0.5, 0.5**0.5), 1.57),
    (SafetyInput.TILT, "imu", imu(0.0, 0.0), float("nan")),
    (SafetyInput.TILT, "imu", imu(0.0, 1.0, covariance=-1.0), float("nan")),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.ERROR), 2.0),
    (SafetyInput.DIAGNOSTICS, "/diagnostics", diagnosis("motor", DiagnosticStatus.OK), 0.0),
]


def only(kind: SafetyInput) -> SafetyInputParams:
    params = replace(SafetyInputParams(), joy=replace(SafetyInputParams().joy, button=1))
    changed = {kind.value: replace(params.of(kind), use=Use.OPTIONAL)}
    return replace(params, **changed)  # type: ignore[arg-type]


@pytest.mark.parametrize(("kind", "topic", "message", "value"), MESSAGES)
async def test_a_message_is_read_as_its_type_says(
    session: Session,
    node: Any,
    until: Until,
    kind: SafetyInput,
    topic: str,
    message: Any,
    value: float,
) -> None:
    readings: list[tuple[SafetyInput, float]] = []
    SafetyInputs(session, only(kind), "r2", lambda each, read, *_: readings.append((each, read)))
    full_name = topic if topic.startswith("/") else f"/r2/{topic}"
    publisher = node.create_publisher(type(message), full_name, 10)
    await until(publisher.get_subscription_count)

    def is_heard() -> bool:
        publisher.publish(message)  # best effort: one message may be lost
        return bool(readings)

    await until(is_heard)
    assert readings[0][0] is kind
    assert readings[0][1] == value or (isnan(value) and isnan(readings[0][1]))


def told(diagnoses: Diagnoses, message: DiagnosticArray) -> tuple[float, str]:
    return diagnoses.worst(serialize_message(message))


def test_the_worst_diagnosis_of_all_names_counts_but_for_our_own() -> None:
    diagnoses = Diagnoses("robot")
    assert told(diagnoses, diagnosis("motor", DiagnosticStatus.ERROR)) == (2.0, "motor: hot")
    assert told(diagnoses, diagnosis("laser", DiagnosticStatus.OK)) == (2.0, "motor: hot")
    assert told(diagnoses, diagnosis("motor", DiagnosticStatus.WARN)) == (1.0, "motor: hot")
    own = diagnosis("robot: recorder", DiagnosticStatus.ERROR, "robot")
    assert told(diagnoses, own) == (1.0, "motor: hot")


def test_the_values_of_a_diagnosis_are_passed_over() -> None:
    message = diagnosis("motor", DiagnosticStatus.OK)
    message.status[0].values = [KeyValue(key="x" * n, value="y" * (n + 1)) for n in range(9)]
    message.status += diagnosis("laser", DiagnosticStatus.ERROR).status
    assert told(Diagnoses("robot"), message) == (2.0, "laser: hot")


def test_many_names_do_not_push_an_error_out() -> None:
    diagnoses = Diagnoses("robot")
    told(diagnoses, diagnosis("motor", DiagnosticStatus.ERROR))
    for number in range(2 * MAX_DIAGNOSES):
        message = diagnosis(f"n{number}", DiagnosticStatus.OK)
        assert told(diagnoses, message) == (2.0, "motor: hot")
