"""The answers to who asks for a drive or waits for its end, on this host or another one."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.base.errors import Refused, UsageError
from robotctl.daemon.api.driving import DrivingMethods
from robotctl.daemon.control import inputs
from robotctl.daemon.control.inputs import Inputs
from robotctl.daemon.control.robot_report import GroundTruth
from robotctl.ipc.method_params import (
    DriveParams,
    DrivePathParams,
    DriveVelocityParams,
    EndDriveParams,
)
from robotctl.kernel.course import Course, Frame, Held
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.state import State
from robotctl.kernel.types import DriveEnded, DriveReport, ModeRequested, Reply
from robotctl.ros.nodes.drive_action import Goal

ENDED = DriveEnded(
    1, True, "drive finished: 1 lap", DriveReport(1, 4.0, 0.01, 0.02, 0.005, 0.03, 0.06, 9.5)
)


class FakeControl:
    """Accepts a drive, which is request 7 and ends as is given, or never; keeps the events."""

    def __init__(self, state: State | None = None, ended: DriveEnded | None = None) -> None:
        self.state = state or State(mode=Mode.MOVING)
        self.ended = ended
        self.params = KernelParams()
        self.events: list[Any] = []
        self.begin = self.events.append

    def stamp(self) -> tuple[int, int]:
        return 0, 7

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        end: asyncio.Future[DriveEnded] = asyncio.get_running_loop().create_future()
        if self.ended is not None:
            end.set_result(self.ended)
        return end

    async def request(self, event: Any) -> Reply:
        self.events.append(event)
        return Reply(event.request_id, True, "Mode changed to MOVING", Mode.MOVING)


async def ask(control: Any, method: str, params: Any) -> Any:
    motion: Any = SimpleNamespace(ground_truth=GroundTruth())
    return await DrivingMethods(control, motion).table()[method].handler(params)


async def wait_for(ended: DriveEnded, mode: Mode, laps: int) -> Any:
    square = DriveParams(pattern=PatternKind.SQUARE, source="test", laps=laps, wait=True)
    return await ask(FakeControl(State(mode=mode), ended), "drive", square)


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.MOVING, Mode.EMERGENCY_STOP])
async def test_a_completed_drive_is_reported_as_completed_in_any_later_mode(mode: Mode) -> None:
    answer = await wait_for(ENDED, mode, laps=1)
    assert (answer["message"], answer["laps"]) == (ENDED.reason, 1)


async def test_a_drive_that_ended_early_is_refused_and_gives_its_numbers() -> None:
    with pytest.raises(Refused, match=r"ended after 1 laps: stopped") as refused:
        await wait_for(replace(ENDED, completed=False, reason="stopped"), Mode.IDLE, laps=2)
    numbers = asdict(ENDED.report)
    assert refused.value.answer == {
        "message": "stopped",
        "mode": "IDLE",
        **numbers,
        **dict.fromkeys(f"true_{name}" for name in numbers if name.startswith(("cross", "head"))),
        "true_closure_m": None,
    }


@pytest.mark.parametrize("mode", [Mode.ERROR, Mode.EMERGENCY_STOP])
async def test_a_drive_without_end_that_a_fault_ends_is_refused(mode: Mode) -> None:
    ended = replace(ENDED, completed=False, reason="stopped")
    assert (await wait_for(ended, Mode.IDLE, laps=0))["message"] == "stopped"
    with pytest.raises(Refused):
        await wait_for(ended, mode, laps=0)


async def test_a_speed_above_the_configured_limit_is_refused_by_name() -> None:
    control = FakeControl()
    for speed_mps in (5.0, 0.6000001, 0.6):
        circle = DriveParams(pattern=PatternKind.CIRCLE, source="test", speed_mps=speed_mps)
        if speed_mps > 0.6:
            said = rf"{speed_mps:.7g} m/s is above limits.linear_mps, 0.6 m/s: use at most"
            with pytest.raises(UsageError, match=said):
                await ask(control, "drive", circle)
        else:
            await ask(control, "drive", circle)
    assert len(control.events) == 1, "the kernel gets the request"


def driving(request_id: int, mode: Mode = Mode.MOVING) -> State:
    pattern = Pattern(PatternKind.SQUARE, 1.0, 0.2)
    return State(mode=mode, drive=Drive(request_id, pattern, 0, Pose(0.0, 0.0, 0.0)))


async def leave(state: State, *, wait: bool = True) -> list[ModeRequested]:
    """Return the requests to the kernel when the client of drive 7 disconnects."""
    control = FakeControl(state)
    square = DriveParams(pattern=PatternKind.SQUARE, source="test", wait=wait)
    task = asyncio.ensure_future(ask(control, "drive", square))
    for _ in range(3):
        await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task})
    return [event for event in control.events if isinstance(event, ModeRequested)]


async def test_the_drive_of_a_client_that_leaves_is_ramped_down() -> None:
    (asked,) = await leave(driving(7))
    assert (asked.requested, asked.source) == (Mode.IDLE, "test, whose connection closed")


@pytest.mark.parametrize(
    "state", [driving(8), driving(7, Mode.EMERGENCY_STOP), driving(7, Mode.ERROR), State()]
)
async def test_a_client_that_leaves_ends_no_other_drive_and_releases_no_stop(state: State) -> None:
    assert await leave(state) == []


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
async def test_ending_a_drive_releases_no_stop(mode: Mode) -> None:
    control = FakeControl(State(mode=mode))
    answer = await ask(control, "end_drive", EndDriveParams(source="test"))
    assert answer == {"message": f"The robot stands, in {mode.name}", "mode": mode.name}
    assert control.events == []


async def test_a_path_becomes_a_request_to_drive_its_points_once() -> None:
    control, points = FakeControl(), [(0.0, 0.0), (1.0, 2.0)]
    path = DrivePathParams(points, Frame.ODOM, corner_m=0.0, reverse=True, source="test")
    await ask(control, "drive_path", path)
    (event,) = control.events
    assert (event.laps, event.pattern.speed_mps) == (1, 0.5)
    assert event.course == Course(
        corner_m=0.0, reverse=True, waypoints=tuple(points), frame=Frame.ODOM
    )


async def test_an_open_pattern_is_driven_once_and_a_closed_one_until_stopped() -> None:
    control = FakeControl()
    for kind in (PatternKind.LINE, PatternKind.SQUARE):
        await ask(control, "drive", DriveParams(pattern=kind, source="test"))
    arc = DriveParams(pattern=PatternKind.ARC, source="test", angle_rad=-1.0)
    await ask(control, "drive", arc)
    assert [event.laps for event in control.events] == [1, 0, 1]
    assert control.events[-1].course == Course(angle_rad=-1.0)


async def test_a_velocity_becomes_a_request_and_is_refused_above_the_limits() -> None:
    control = FakeControl()
    await ask(control, "drive_velocity", DriveVelocityParams(0.2, -0.5, 2.0, source="test"))
    assert control.events[-1].course == Course(held=Held(0.2, -0.5, 2.0))
    for linear_mps, angular_rps in ((-0.7, 0.0), (0.0, 1.6)):
        wanted = DriveVelocityParams(linear_mps, angular_rps, 2.0, source="test")
        with pytest.raises(UsageError, match=r"is above limits\.(linear|angular)"):
            await ask(control, "drive_velocity", wanted)


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
    monkeypatch.setattr(inputs, "requester", lambda: client)
    assert inputs.is_remote(OWN) is is_remote


async def test_services_and_goals_tell_whether_they_are_remote() -> None:
    control: Any = FakeControl()
    report: Any = None
    Inputs(control, report, lambda: True).service_call(Mode.MOVING.value, "the ROS service")
    goal = Goal("", 0.0, 1, 0.0, False)
    DrivingMethods(control, report).begin_goal(goal, "the ROS action", remote=True)
    assert [event.remote for event in control.events] == [True, True]
