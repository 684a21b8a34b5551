"""A request counts as one of another host, unless its client is surely on this one."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.daemon import remote_requests
from robotctl.daemon.control.inputs import Inputs
from robotctl.daemon.drive_goals import DriveGoals
from robotctl.daemon.remote_requests import RemoteRequests
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.ros.nodes.drive_action import Goal

OWN = bytes.fromhex("010f1a2b") + bytes(12)
HERE = bytes.fromhex("010f1a2b") + bytes(range(12))
ELSEWHERE = bytes.fromhex("010f99bb") + bytes(range(12))


@pytest.mark.parametrize(
    ("discovery", "client", "is_remote"),
    [
        ("LOCALHOST", HERE, False),
        ("LOCALHOST", ELSEWHERE, True),
        ("LOCALHOST", None, False),
        ("SUBNET", HERE, False),
        ("SUBNET", ELSEWHERE, True),
        ("SUBNET", None, True),
    ],
)
def test_a_client_is_remote_by_the_host_of_its_gid_in_every_range(
    discovery: str, client: bytes | None, is_remote: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery)
    monkeypatch.setattr(remote_requests, "requester", lambda: client)
    assert RemoteRequests(OWN).is_remote() is is_remote


class Asked:
    """A control that keeps the events."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.begin = self.events.append

    def new_request_id(self) -> int:
        return 1

    def expect_end(self, request_id: int) -> None:
        pass


def test_services_and_goals_tell_whether_they_are_remote() -> None:
    control: Any = Asked()
    report: Any = None
    Inputs(control, report, lambda: True).service_call(Mode.MOVING.value, "the ROS service")

    class Driving:
        def pattern(self, *_: object) -> Pattern:
            return Pattern()

    driving: Any = Driving()
    DriveGoals(control, driving, lambda: True).begin(Goal("", 0.0, 1, 0.0, False), "the ROS action")
    assert [event.remote for event in control.events] == [True, True]
