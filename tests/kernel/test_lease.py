"""With a lease only its holder starts and steers motion; anybody stops.

Another host starts no motion unless it is allowed to; it stops the robot always.
A guarded motion: another node wants velocities; limits, silence and every rule still hold.
The lifecycle of the node that gates motion is a start condition.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

from robotctl.ipc.advice import cure_of
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.state import Guarded
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveRequested,
    ForeignCommandHeard,
    GuardedCommandReceived,
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    LifecycleState,
    LoopStalled,
    ModeRequested,
    Phase,
    Remedy,
    ResetRequested,
    Twist,
)
from robotctl.testing.kernels import Bench, moving, ready, start, stopped_by
from tests.support.cases import for_each

HOLDER, OTHER, ROS = 1, 2, 0
"""The numbers of clients: one is greater than that of the holder, one is less."""


def ask(bench: Bench, client: int, *, take: bool = True, reason: str = "") -> str:
    """Take or release the lease; return the refusal, "" if it was granted."""
    request_id = bench.new_request_id()
    bench.give(LeaseRequested(bench.t_ns, request_id, take, client, f"client {client}", reason))
    return "" if bench.replies[-1].ok else bench.replies[-1].message


def held() -> Bench:
    bench = ready()
    assert ask(bench, HOLDER, reason="inspection") == ""
    return bench


def move(bench: Bench, client: int, mode: Mode = Mode.MOVING) -> str:
    request_id = bench.new_request_id()
    bench.give(ModeRequested(bench.t_ns, request_id, mode, f"client {client}", client))
    return "" if bench.replies[-1].ok else bench.replies[-1].message


def drive(bench: Bench, client: int, *, replacing: bool = False) -> str:
    request_id = bench.new_request_id()
    bench.give(
        DriveRequested(
            bench.t_ns, request_id, Pattern(), 0, replacing, f"client {client}", client, "a reason"
        )
    )
    return "" if bench.replies[-1].ok else bench.replies[-1].message


@for_each("client", [OTHER, ROS])
@for_each("start", [move, drive])
def test_a_motion_of_another_is_refused_with_who_holds_and_who_asked(
    client: int, start: Callable[[Bench, int], str]
) -> None:
    bench = held()
    assert start(bench, client) == (
        f"client {HOLDER} holds the lease (inspection), and client {client} asked"
    )
    assert bench.replies[-1].remedies == (Remedy.WAIT_FOR_LEASE,)
    assert bench.state.mode is Mode.IDLE


@for_each("client", [OTHER, ROS])
def test_the_holder_alone_starts_and_steers(client: int) -> None:
    bench = held()
    assert drive(bench, HOLDER) == ""
    assert "holds the lease" in drive(bench, client, replacing=True)
    assert drive(bench, HOLDER, replacing=True) == ""
    assert bench.state.reason == f"requested by client {HOLDER}: a reason"


@for_each("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
def test_anybody_stops_and_resets(mode: Mode) -> None:
    bench = held()
    drive(bench, HOLDER)
    bench.run(10)
    request_id = bench.new_request_id()
    bench.give(ModeRequested(bench.t_ns, request_id, mode, "passer-by", OTHER, "a child"))
    bench.run(100)
    assert (bench.state.mode, bench.state.command) == (mode, ZERO)
    assert bench.state.reason == "requested by passer-by: a child"
    bench.give(ResetRequested(bench.t_ns, bench.new_request_id(), "passer-by", "it is gone"))
    assert bench.state.mode is Mode.IDLE
    assert "holds the lease" in move(bench, OTHER)


@for_each(
    ("lost", "why"),
    [
        (LeaseLost(0, HOLDER), "client 1 lost the lease: its connection closed"),
        (LeaseLost(0, HOLDER, "it froze"), "client 1 lost the lease: it froze"),
        (None, "client 1 released the lease"),
    ],
)
def test_the_robot_ramps_down_within_2_s_when_its_lease_ends(
    lost: LeaseLost | None, why: str
) -> None:
    bench = held()
    drive(bench, HOLDER)
    bench.run(50)
    assert bench.state.command.linear > 0.0
    began_ns = bench.t_ns
    if lost is not None:
        bench.give(replace(lost, t_ns=bench.t_ns))
    else:
        assert ask(bench, HOLDER, take=False) == ""
    assert bench.state.phase is Phase.STOPPING
    while bench.state.mode is Mode.MOVING:
        bench.run(1)
    assert bench.t_ns - began_ns < 2_000_000_000
    assert bench.state.reason == why
    assert move(bench, OTHER) == ""


def test_a_lease_is_taken_once_and_released_by_its_holder() -> None:
    bench = held()
    for client in (HOLDER, OTHER):
        assert ask(bench, client) == (
            f"client {HOLDER} holds the lease (inspection), and client {client} asked"
        )
    for client in (OTHER, ROS):
        assert "holds the lease" in ask(bench, client, take=False)
        bench.give(LeaseLost(bench.t_ns, client))
        assert bench.state.lease is not None
    assert ask(bench, HOLDER, take=False) == ""
    assert ask(bench, HOLDER, take=False) == ""
    assert bench.replies[-1].message == "Nobody holds the lease"


def test_no_lease_is_taken_over_the_motion_of_another() -> None:
    bench = moving()
    assert ask(bench, HOLDER) == "the robot is MOVING"
    assert bench.state.lease is None


REMOTE_MOTION = KernelParams(remote_motion=True)


def move_of_remote_motion(bench: Bench, *, remote: bool) -> None:
    event = ModeRequested(bench.t_ns, 1, Mode.MOVING, "the ROS service", remote=remote)
    bench.give(event)


def drive_of_remote_motion(bench: Bench, *, remote: bool) -> None:
    event = DriveRequested(bench.t_ns, 1, Pattern(), 1, False, "the ROS service", remote=remote)
    bench.give(event)


@for_each("ask", [move_of_remote_motion, drive_of_remote_motion])
def test_a_motion_that_another_host_asks_for_is_refused_and_the_robot_stands(
    ask: Callable[..., None],
) -> None:
    bench = ready()
    ask(bench, remote=True)
    (reply,) = bench.replies
    assert not reply.ok
    assert reply.message == "the ROS service was called from another host, or may have been"
    assert reply.remedies == (Remedy.ASK_HERE,)
    bench.run(5)
    assert bench.state.mode is Mode.IDLE


@for_each("ask", [move_of_remote_motion, drive_of_remote_motion])
@for_each(("remote", "params"), [(True, REMOTE_MOTION), (False, KernelParams())])
def test_a_motion_is_granted_to_this_host_and_to_another_one_where_that_is_configured(
    ask: Callable[..., None], remote: bool, params: KernelParams
) -> None:
    bench = ready(params)
    ask(bench, remote=remote)
    assert bench.replies[-1].ok
    assert bench.state.mode is Mode.MOVING


@for_each("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
def test_another_host_stops_the_robot(mode: Mode) -> None:
    bench = moving()
    bench.give(ModeRequested(bench.t_ns, 7, mode, "the ROS service", remote=True))
    bench.run(100)
    assert bench.state.mode is mode


GUARDING = replace(KernelParams(), guard=True)


def wanted(bench: Bench, twist: Twist, ticks: int = 1) -> None:
    """Let another node want this velocity at each tick."""
    for _ in range(ticks):
        bench.give(GuardedCommandReceived(bench.t_ns, twist))
        bench.run(1)


def guarding(params: KernelParams = GUARDING) -> Bench:
    bench = ready(params)
    bench.request(Mode.MOVING)
    assert bench.replies[-1].message == "Mode changed to MOVING: guarding cmd_vel_nav"
    assert bench.state.command == ZERO
    return bench


def test_what_another_node_wants_is_commanded_within_the_limits() -> None:
    bench = guarding()
    wanted(bench, Twist(0.2, -0.4), ticks=30)
    assert bench.state.command == Twist(0.2, -0.4)
    wanted(bench, Twist(5.0, 9.0), ticks=100)
    limits = bench.kernel.params.limits
    assert bench.state.command == Twist(limits.linear_mps, limits.angular_rps)
    steps = [b.linear - a.linear for a, b in zip(bench.commands, bench.commands[1:], strict=False)]
    assert max(steps) <= limits.linear_accel_mps2 * 0.02 + 1e-9


def test_the_silence_is_counted_from_the_last_velocity_whatever_the_clock_shows() -> None:
    early = Guarded(Twist(0.3, 0.0), NS_PER_S)
    assert early.wanted(NS_PER_S + NS_PER_S // 2, 0.5) == Twist(0.3, 0.0)
    assert early.wanted(3 * NS_PER_S, 0.5) is None
    assert early.wanted(0, 0.5) is None


def test_a_silence_of_a_quarter_of_a_second_is_zero_at_once() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.run(11)  # 0.24 s
    assert bench.state.command.linear > 0.0
    bench.run(2)
    assert (bench.state.mode, bench.state.command) == (Mode.MOVING, ZERO)
    wanted(bench, Twist(0.3, 0.0), ticks=1)
    assert 0.0 < bench.state.command.linear <= 0.02 + 1e-9


@for_each("number", [nan, inf, -inf])
def test_a_velocity_that_is_no_number_is_zero(number: float) -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.1), ticks=30)
    wanted(bench, Twist(number, 0.1))
    assert bench.state.command == ZERO
    wanted(bench, Twist(0.3, 0.1), ticks=30)
    wanted(bench, Twist(0.3, number))
    assert bench.state.command == ZERO


def test_the_rules_of_the_safety_table_stop_a_guarded_motion() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.give(ForeignCommandHeard(bench.t_ns, "/joystick"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)
    wanted(bench, Twist(0.3, 0.0), ticks=10)
    assert bench.state.command == ZERO
    assert bench.state.guarded is None


@for_each(("field", "value"), [("battery", 0.1), ("odometry", Pose(nan, 0.0, 0.0)), ("stall", 1.0)])
def test_a_guarded_motion_ends_as_any_other(field: str, value: object) -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    if isinstance(value, Pose):
        for _ in range(40):
            bench.give(GuardedCommandReceived(bench.t_ns, Twist(0.3, 0.0)))
            bench.odometry(value)
            bench.tick()
    elif field == "battery":
        bench.battery(0.1)
    else:
        bench.give(LoopStalled(bench.t_ns, 1.0, 10, 0, "a test"))
    assert bench.state.mode in (Mode.ERROR, Mode.EMERGENCY_STOP)
    assert bench.state.command == ZERO


def test_a_request_for_idle_ramps_a_guarded_motion_down() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.request(Mode.IDLE)
    wanted(bench, Twist(0.3, 0.0), ticks=50)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)
    assert bench.replies[-1].ok


def test_outside_of_a_guarded_motion_nothing_that_others_want_is_commanded() -> None:
    bench = ready(GUARDING)
    wanted(bench, Twist(0.3, 0.0), ticks=10)
    assert bench.state.command == ZERO
    bench.drive()
    before = bench.state.drive
    wanted(bench, Twist(-0.6, 1.0), ticks=20)
    assert before is not None
    assert bench.state.command.linear >= 0.0
    bench.drive(replacing=True)
    assert bench.state.guarded is None


STOPPED = [state for state in LifecycleState if state is not LifecycleState.ACTIVE]


@for_each("state", STOPPED)
def test_motion_starts_only_while_the_node_is_active(state: LifecycleState) -> None:
    bench = ready()
    bench.give(LifecycleChanged(bench.t_ns, state, "a test"))
    bench.run(3)
    assert start(bench) == f"mode_service is {state.value}, not active"
    (remedy,) = bench.replies[-1].remedies
    assert "change_state '{transition: {label: activate}}' --robot r2" in cure_of(remedy, "r2")
    bench.give(LifecycleChanged(bench.t_ns, LifecycleState.ACTIVE, "a test"))
    assert start(bench) == ""
