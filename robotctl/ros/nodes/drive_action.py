"""The action that drives a pattern."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import nan
from operator import attrgetter
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from robot_controller.action import DrivePattern

from robotctl.kernel.types import DriveEnded, Reply
from robotctl.ros import qos

ACTION = "drive_pattern"

FEEDBACK_PERIOD_S = 0.2

RESULT_KEPT_S = 10
"""The time [s] after the end of a goal in which its client may ask for the result."""

# Each change of one goal publishes the status of all.
MAX_GOALS = 64
"""Limit on the goals with kept results. Above it, a goal is rejected without a reason."""


@dataclass(frozen=True, slots=True)
class Goal:
    """The fields of a goal of DrivePattern.action."""

    pattern: str
    """The name of a pattern, or "" for the configured one."""
    size_m: float
    """The size of the pattern, or 0 for the default."""
    laps: int
    speed_mps: float
    """The speed, or 0 for the default."""
    replace: bool
    """Whether to replace the present drive."""


@dataclass(frozen=True, slots=True)
class DriveProgress:
    """How far a drive has come, for the feedback of its action goal."""

    distance_m: float
    laps: int
    cross_track_m: float
    """The present distance from the path."""


@dataclass(frozen=True, slots=True)
class GoalDrive:
    """The handle of the drive that one action goal has requested."""

    reply: asyncio.Future[Reply]
    """The kernel's reply to the request for the drive."""

    ended: asyncio.Future[DriveEnded]
    """Set when the drive ends. It stays pending if the drive is refused."""

    progress: Callable[[], DriveProgress | None]
    """Returns the progress, or None if the drive has not begun or has ended."""

    ramp_down: Callable[[], bool]
    """Ramps down and ends the drive. Returns False if the drive has ended already."""


class DriveAction:
    """The action `drive_pattern` (DrivePattern) of a node, which drives for each accepted goal.

    Feedback is published each `FEEDBACK_PERIOD_S`. If the kernel refuses a drive, the goal is
    aborted with the reason.
    """

    def __init__(
        self,
        node: Node,
        begin: Callable[[Goal, str], GoalDrive],
        say: Callable[[Reply], str] = attrgetter("message"),
    ) -> None:
        """Call `begin(goal, source)`, which must return at once, for each goal.

        `begin` raises ValueError, with the reason, for an invalid goal. `say` returns the text of a
        refusal for the client.
        """
        self._begin = begin
        self._say = say
        self._source = f"the ROS action {node.resolve_topic_name(ACTION)}"
        self._drives: dict[bytes, GoalDrive] = {}
        self._server = ActionServer(
            node,
            DrivePattern,
            ACTION,
            self._refuse,
            callback_group=MutuallyExclusiveCallbackGroup(),
            goal_callback=self._has_room,
            handle_accepted_callback=self._accept,
            cancel_callback=self._cancel,
            goal_service_qos_profile=qos.REQUESTS,
            cancel_service_qos_profile=qos.REQUESTS,
            result_service_qos_profile=qos.REQUESTS,
            result_timeout=RESULT_KEPT_S,
        )

    def close(self) -> None:
        """Destroy the action server, which the node does not destroy."""
        self._server.destroy()

    def _has_room(self, _: Any) -> GoalResponse:
        self._end_unanswered()
        full = len(self._server._goal_handles) >= MAX_GOALS
        return GoalResponse.REJECT if full else GoalResponse.ACCEPT

    def _end_unanswered(self) -> None:
        """Abort goals that rclpy has accepted, but does not execute because its answer failed."""
        for handle in list(self._server._goal_handles.values()):
            if handle.status == GoalStatus.STATUS_ACCEPTED:
                handle.execute(self._refuse)

    def _accept(self, handle: Any) -> None:
        """Request the drive at once, as the goal's task starts only in a later turn of the loop."""
        asked = handle.request
        goal = Goal(asked.pattern, asked.size, asked.laps, asked.speed, asked.replace)
        try:
            drive = self._begin(goal, self._source)
        except ValueError as error:
            handle.execute(partial(self._refuse, reason=str(error)))
            return
        self._drives[bytes(handle.goal_id.uuid)] = drive
        handle.execute(partial(self._follow, drive))

    def _cancel(self, handle: Any) -> CancelResponse:
        drive = self._drives.get(bytes(handle.goal_id.uuid))
        ends = drive is not None and drive.ramp_down()
        return CancelResponse.ACCEPT if ends else CancelResponse.REJECT

    def _refuse(self, handle: Any, reason: str = "") -> Any:
        handle.abort()
        return DrivePattern.Result(
            reason=reason, cross_track_rms=nan, cross_track_max=nan, closure=nan
        )

    async def _follow(self, drive: GoalDrive, handle: Any) -> Any:
        try:
            reply = await drive.reply
            if not reply.ok:
                drive.ramp_down()  # the drive runs if only its first command could not be sent
                return self._refuse(handle, self._say(reply))
            while not drive.ended.done():
                self._publish_feedback(drive, handle)
                await asyncio.wait({drive.ended}, timeout=FEEDBACK_PERIOD_S)
            return _finish(handle, drive.ended.result())
        finally:
            drive.ended.cancel()
            del self._drives[bytes(handle.goal_id.uuid)]

    def _publish_feedback(self, drive: GoalDrive, handle: Any) -> None:
        progress = drive.progress()
        if progress is None:
            return
        feedback = DrivePattern.Feedback()
        feedback.distance = progress.distance_m
        feedback.lap = progress.laps + 1
        feedback.cross_track_error = progress.cross_track_m
        handle.publish_feedback(feedback)


def _finish(handle: Any, ended: DriveEnded) -> Any:
    """Set the goal's final state, and return its result."""
    if ended.completed:
        handle.succeed()
    elif handle.is_cancel_requested and ended.cause is None:
        handle.canceled()
    else:
        handle.abort()
    report = ended.report
    return DrivePattern.Result(
        completed=ended.completed,
        reason=ended.reason,
        laps=report.laps,
        distance=report.distance_m,
        cross_track_rms=report.cross_track_rms_m,
        cross_track_max=report.cross_track_max_m,
        closure=report.closure_m,
    )
