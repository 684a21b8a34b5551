"""Requests of other hosts start no motion, and stop the robot as any other."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.daemon import remote_requests
from robotctl.daemon.control.inputs import Inputs
from robotctl.daemon.drive_goals import DriveGoals
from robotctl.daemon.remote_requests import RemoteRequests
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.ros.nodes.drive_action import Goal
from robotctl.testing.kernels import moving, ready

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


@pytest.mark.parametrize("remote_motion", [False, True])
def test_a_remote_request_for_motion_needs_the_configured_permission(remote_motion: bool) -> None:
    for make in (
        lambda bench: ModeRequested(bench.t_ns, 1, Mode.MOVING, "the ROS service", remote=True),
        lambda bench: DriveRequested(
            bench.t_ns, 1, Pattern(), 1, False, "the ROS action", remote=True
        ),
    ):
        bench = ready(KernelParams(remote_motion=remote_motion))
        bench.give(make(bench))
        assert bench.replies[-1].ok is remote_motion
        if not remote_motion:
            assert "was called from another host" in bench.replies[-1].message
            assert bench.replies[-1].remedies == (Remedy.ASK_HERE,)


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
def test_a_remote_request_stops_the_robot(mode: Mode) -> None:
    bench = moving()
    bench.give(ModeRequested(bench.t_ns, 7, mode, "the ROS service", remote=True))
    bench.run(100)
    assert bench.state.mode is mode


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
