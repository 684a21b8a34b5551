"""Converts input from ROS into events for the kernel."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable

from robotctl.base.domains import is_on_this_machine_only
from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.robot_report import RobotReport
from robotctl.daemon.supervisor import until
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import (
    CommandListenersSeen,
    CommandPublishersSeen,
    Event,
    ForeignCommandHeard,
    GuardedCommandReceived,
    LifecycleChanged,
    LifecycleState,
    ModeRequested,
    Odometry,
    OdomReceived,
    Reply,
    Twist,
)
from robotctl.ros.executor import requester
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher

REPEAT_NS = 200_000_000
"""Least time between two events about one publisher's commands while the robot stands."""

MAX_TOLD = 16
"""Limit on the publishers with an event in REPEAT_NS while the robot stands."""

NAMELESS = "a publisher that is gone, or has no name yet,"


class ForeignCommands:
    """Dispatches an event for each velocity command of a publisher other than `own_gid`.

    While `moves()` is false, each publisher causes at most one event in REPEAT_NS.
    """

    def __init__(
        self,
        own_gid: bytes,
        name_of: Callable[[bytes], str],
        moves: Callable[[], bool],
        dispatch: Callable[[Event], None],
    ) -> None:
        self._own_gid = own_gid
        self._name_of = name_of
        self._moves = moves
        self._dispatch = dispatch
        self._told_ns: dict[bytes, int] = {}
        """Time of the last event of each recent publisher [steady ns]."""

    def heard(self, gid: bytes) -> None:
        """Handle a command of the publisher `gid`."""
        if gid == self._own_gid:
            return
        now_ns = time.monotonic_ns()
        if not self._moves() and not self._may_tell(gid, now_ns):
            return
        self._told_ns[gid] = now_ns
        self._dispatch(ForeignCommandHeard(now_ns, self._name_of(gid) or NAMELESS))

    def _may_tell(self, gid: bytes, now_ns: int) -> bool:
        told_ns = self._told_ns.get(gid)
        if told_ns is not None and now_ns - told_ns < REPEAT_NS:
            return False
        if len(self._told_ns) >= MAX_TOLD:
            self._told_ns = {g: t for g, t in self._told_ns.items() if now_ns - t < REPEAT_NS}
        return len(self._told_ns) < MAX_TOLD


PUBLISHER_POLL_S = 0.2

LOOKS_PER_INSPECTION = 5
"""Number of looks after which `watch_graph` reads the subscriptions even at an unchanged count."""


async def has_odometry_publisher(
    odometry: OdomSubscriber, stop: asyncio.Event, until_s: float
) -> bool:
    """Return whether odometry gets a publisher before `stop` is set or `until_s` [steady s]."""
    remaining_s = until_s - time.monotonic()
    await until(lambda: odometry.count_publishers() > 0 or stop.is_set(), remaining_s)
    return odometry.count_publishers() > 0


async def watch_graph(
    velocity: VelocityPublisher,
    odometry: OdomSubscriber,
    dispatch: Callable[[Event], None],
) -> None:
    """Dispatch changes of the command topic's subscribers and other publishers, until cancelled."""
    publishers: tuple[str, ...] = ()
    listeners: tuple[int, tuple[str, ...], str] | None = None
    count = -1
    for look in itertools.count():
        others = velocity.other_publishers()
        if others != publishers:
            publishers = others
            dispatch(CommandPublishersSeen(time.monotonic_ns(), others))
        if count != (count := velocity.count_listeners()) or look % LOOKS_PER_INSPECTION == 0:
            seen = velocity.listeners()
            if seen != listeners:
                listeners = seen
                dispatch(CommandListenersSeen(time.monotonic_ns(), *seen))
        odometry.find_names()
        await asyncio.sleep(PUBLISHER_POLL_S)


class Inputs:
    """Handlers that pass inputs from ROS to the kernel. Call them in the loop's thread."""

    def __init__(
        self,
        control: Control,
        robot_report: RobotReport,
        is_remote: Callable[[], bool] = lambda: False,
    ) -> None:
        """`is_remote()` returns whether the present request may come from another host."""
        self._is_remote = is_remote
        self._control = control
        self._robot_report = robot_report

    def odometry(self, odometry: Odometry, source: int, sequence: int) -> None:
        """Handle an odometry sample of the publisher with the number `source`."""
        self._control.dispatch(OdomReceived(time.monotonic_ns(), odometry, source, sequence))
        state = self._control.state
        if state.drive is not None and state.health.odometry is odometry:  # it was not dropped
            self._robot_report.drove_to(odometry.pose)

    def hears(self, kind: Callable[..., Event]) -> Callable[..., None]:
        """Return a handler whose call with values dispatches the event `kind(now_ns, *values)`."""
        return lambda *values: self._control.dispatch(kind(time.monotonic_ns(), *values))

    def guarded_command(self, twist: Twist, publisher: str, sequence: int) -> None:
        """Handle a velocity that another node requests for a guarded motion."""
        if self._control.state.guarded is not None:
            self._control.dispatch(
                GuardedCommandReceived(time.monotonic_ns(), twist, publisher, sequence)
            )

    def lifecycle(self, state: LifecycleState, source: str) -> None:
        """Handle a transition of the lifecycle node. A state other than ACTIVE ramps down."""
        present = self._control.state
        if state is present.health.lifecycle:
            return
        self._control.dispatch(LifecycleChanged(time.monotonic_ns(), state, source))
        if state is not LifecycleState.ACTIVE and present.mode is Mode.MOVING:
            self.service_call(Mode.IDLE.value, source)

    def service_call(self, requested: int, source: str) -> asyncio.Future[Reply]:
        """Dispatch the mode request of a ROS node, and return the future of its reply."""
        return self._control.begin(
            ModeRequested(*self._control.stamp(), requested, source, remote=self._is_remote())
        )


HOST = slice(4)
"""The part of a gid of Fast DDS that names vendor and host."""


def is_remote(own_gid: bytes) -> bool:
    """Return whether the request being handled may be of another host. Clients can forge this."""
    # Even with discovery limited to this machine, another host may name it as its static peer.
    gid = requester()
    return not is_on_this_machine_only() if gid is None else gid[HOST] != own_gid[HOST]
