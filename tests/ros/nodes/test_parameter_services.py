"""The parameter services of a node take any request, and ask for what rclpy would grant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically

from robotctl.kernel.ranges import Range
from robotctl.ros.nodes.node_services import Declared, ParameterServices
from robotctl.ros.session import Session

DECLARED = (
    Declared("speed", 0.6, "a speed", "0 to 1 m/s", Range(0.0, 1.0, "m/s"), read_only=False),
    Declared("number", 3, "a number", "0 to 9", Range(0, 9), read_only=False),
    Declared("topics", [], "topics", "a list", None, read_only=True),
)


class Asked:
    """Keeps what was asked, and refuses what it is told to."""

    def __init__(self) -> None:
        self.settings: list[tuple[str, Any]] = []
        self.refusal = ""

    def __call__(self, settings: Sequence[tuple[str, Any]], source: str) -> str:
        self.settings += settings
        assert source == "the ROS service /r2/some_node/set_parameters"
        return self.refusal


def served(session: Session) -> tuple[ParameterServices, Asked, Any]:
    asked, node = Asked(), session.node("some_node")
    return ParameterServices(node, DECLARED, asked), asked, node


def speed(value: float) -> ParameterMessage:
    return ParameterMessage(name="speed", value=ParameterValue(type=3, double_value=value))


async def test_a_value_of_a_type_that_does_not_exist_is_refused(session: Session) -> None:
    services, asked, _ = served(session)
    odd = ParameterMessage(name="speed", value=ParameterValue(type=99))
    deleted = ParameterMessage(name="speed", value=ParameterValue(type=0))
    request = SetParameters.Request(parameters=[odd, deleted, ParameterMessage(name="\x1b[2J")])
    response = services._set_one_by_one(request, SetParameters.Response())
    assert [each.successful for each in response.results] == [False, False, False]
    assert "\x1b" not in response.results[2].reason
    assert asked.settings == []


async def test_a_refusal_keeps_the_value_and_a_grant_takes_it(session: Session) -> None:
    services, asked, node = served(session)
    asked.refusal = "not now"
    request = SetParametersAtomically.Request(parameters=[speed(0.5)])
    refused = services._set_all_or_none(request, SetParametersAtomically.Response()).result
    assert (refused.successful, refused.reason) == (False, "not now")
    assert node.get_parameter("speed").value == 0.6
    asked.refusal = ""
    assert services._set_all_or_none(request, SetParametersAtomically.Response()).result.successful
    assert node.get_parameter("speed").value == 0.5
    assert asked.settings == [("speed", 0.5), ("speed", 0.5)]


async def test_a_value_that_changed_otherwise_is_shown_without_being_asked_for(
    session: Session,
) -> None:
    services, asked, node = served(session)
    services.show("number", 4)
    services.show("another key", 4)
    assert (node.get_parameter("number").value, asked.settings) == (4, [])
    assert node.get_parameter("topics").value == []
