"""The action's node forwards goals and cancels, and ends goals as their drives end."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator, Callable
from math import nan
from types import SimpleNamespace
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from rclpy.action.server import CancelResponse, GoalResponse
from robot_controller.action import DrivePattern

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Cause, DriveEnded, DriveReport, Reply
from robotctl.ros.nodes import drive_action
from robotctl.ros.nodes.drive_action import DriveAction, DriveProgress, Goal
from robotctl.ros.session import Session

ACCEPTED = Reply(1, True, "", Mode.MOVING)
FINISHED = DriveEnded(1, True, "finished", DriveReport(1, 4.0, 0.01, 0.02, 0.005))
CUT = DriveEnded(1, False, "why", DriveReport(0, 0.1, nan, nan, nan))


class FakeDrive:
    """A drive that the test answers and ends."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        self.reply: asyncio.Future[Reply] = loop.create_future()
        self.ended: asyncio.Future[DriveEnded] = loop.create_future()
        self.ramps = 0

    def progress(self) -> DriveProgress:
        return DriveProgress(1.5, 0, 0.25)

    def ramp_down(self) -> bool:
        self.ramps += 1
        return not self.ended.done()

    def end(self, ended: DriveEnded) -> None:
        self.reply.set_result(ACCEPTED)
        self.ended.set_result(ended)


class FakeHandle:
    """rclpy's handle of a goal; `result` is the task of its execution."""

    def __init__(self, **goal: Any) -> None:
        self.request = DrivePattern.Goal(**goal)
        self.goal_id = SimpleNamespace(uuid=list(range(16)))
        self.status = GoalStatus.STATUS_ACCEPTED
        self.is_cancel_requested = False
        self.feedback: list[Any] = []
        self.told = asyncio.Event()

    def execute(self, callback: Callable[[Any], Any]) -> None:
        self.status = GoalStatus.STATUS_EXECUTING

        async def run() -> Any:
            result = callback(self)
            return await result if inspect.isawaitable(result) else result

        self.result = asyncio.create_task(run())

    def publish_feedback(self, feedback: Any) -> None:
        self.feedback.append(feedback)
        self.told.set()

    def succeed(self) -> None:
        self.status = GoalStatus.STATUS_SUCCEEDED

    def abort(self) -> None:
        self.status = GoalStatus.STATUS_ABORTED

    def canceled(self) -> None:
        self.status = GoalStatus.STATUS_CANCELED


class Served:
    """An action server whose requests the test makes."""

    def __init__(self, session: Session) -> None:
        self.asked: list[tuple[Goal, str]] = []
        self.drives: list[FakeDrive] = []
        self.action = DriveAction(session.node("server"), self._begin, lambda reply: "said")

    def _begin(self, goal: Goal, source: str) -> Any:
        if goal.pattern == "none":
            raise ValueError("no such pattern")
        self.asked.append((goal, source))
        self.drives.append(FakeDrive())
        return self.drives[-1]

    def accept(self, **goal: Any) -> FakeHandle:
        handle = FakeHandle(**goal)
        self.action._accept(handle)
        return handle


@pytest.fixture
async def served(session: Session) -> AsyncIterator[Served]:
    """The action of a node in the namespace /r2."""
    served = Served(session)
    yield served
    served.action._server._goal_handles.clear()  # those of the tests are not rclpy's
    served.action.close()


async def test_a_goal_is_forwarded_and_told_how_far_it_is(served: Served) -> None:
    handle = served.accept(pattern="circle", size=0.5, laps=3, speed=0.2, replace=True)
    assert served.asked == [(Goal("circle", 0.5, 3, 0.2, True), "the ROS action /r2/drive_pattern")]
    served.drives[0].reply.set_result(ACCEPTED)
    await handle.told.wait()
    told = handle.feedback[0]
    assert (told.distance, told.lap, told.cross_track_error) == (1.5, 1, 0.25)
    served.drives[0].ended.set_result(FINISHED)
    result = await handle.result
    assert handle.status == GoalStatus.STATUS_SUCCEEDED
    assert (result.completed, result.reason, result.laps) == (True, "finished", 1)
    errors = result.cross_track_rms, result.cross_track_max, result.closure
    assert (result.distance, *errors) == (4.0, 0.01, 0.02, 0.005)


@pytest.mark.parametrize(
    ("cause", "status"),
    [(None, GoalStatus.STATUS_CANCELED), (Cause.ODOMETRY_LOST, GoalStatus.STATUS_ABORTED)],
)
async def test_a_cancelled_goal_is_canceled_unless_a_fault_ended_it(
    served: Served, cause: Cause | None, status: int
) -> None:
    handle = served.accept()
    assert served.action._cancel(handle) is CancelResponse.ACCEPT
    assert served.drives[0].ramps == 1
    handle.is_cancel_requested = True
    served.drives[0].end(DriveEnded(1, False, "why", CUT.report, cause))
    assert (await handle.result).reason == "why"
    assert handle.status == status


async def test_a_drive_that_has_ended_cannot_be_cancelled(served: Served) -> None:
    handle = served.accept()
    served.drives[0].end(FINISHED)
    assert served.action._cancel(handle) is CancelResponse.REJECT
    await handle.result
    assert served.action._cancel(handle) is CancelResponse.REJECT
    assert handle.status == GoalStatus.STATUS_SUCCEEDED


async def test_a_drive_that_a_stop_ends_is_aborted(served: Served) -> None:
    handle = served.accept()
    served.drives[0].end(CUT)
    assert (await handle.result).completed is False
    assert handle.status == GoalStatus.STATUS_ABORTED


async def test_a_refused_goal_is_aborted_and_leaves_no_drive(served: Served) -> None:
    handle = served.accept()
    served.drives[0].reply.set_result(Reply(1, False, "no", Mode.MOVING))
    assert (await handle.result).reason == "said"
    assert handle.status == GoalStatus.STATUS_ABORTED
    assert served.drives[0].ramps == 1
    assert served.drives[0].ended.cancelled()
    handle = served.accept(pattern="none")
    assert (await handle.result).reason == "no such pattern"
    assert handle.status == GoalStatus.STATUS_ABORTED
    assert len(served.asked) == 1


async def test_more_goals_than_are_kept_are_rejected(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive_action, "MAX_GOALS", 2)
    kept: dict[bytes, Any] = served.action._server._goal_handles
    answers = []
    for number in range(3):
        answers.append(served.action._has_room(DrivePattern.Goal()))
        kept[bytes([number])] = FakeHandle()
        kept[bytes([number])].abort()
    kept.clear()
    assert answers == [GoalResponse.ACCEPT, GoalResponse.ACCEPT, GoalResponse.REJECT]


async def test_a_goal_whose_answer_was_lost_is_ended(served: Served) -> None:
    """rclpy keeps such a goal for ever, accepted and never executed."""
    kept: dict[bytes, Any] = served.action._server._goal_handles
    lost = kept[b"lost"] = FakeHandle()
    served.action._has_room(DrivePattern.Goal())
    kept.clear()
    await lost.result
    assert lost.status == GoalStatus.STATUS_ABORTED
    assert served.asked == []
