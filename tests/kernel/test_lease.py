"""With a lease only its holder starts and steers motion; anybody stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import ZERO, DriveRequested, ModeRequested, Phase, ResetRequested
from robotctl.kernel.types.events import LeaseLost, LeaseRequested
from robotctl.testing.kernels import Bench, moving, ready

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


@pytest.mark.parametrize("client", [OTHER, ROS])
@pytest.mark.parametrize("start", [move, drive])
def test_a_motion_of_another_is_refused_with_who_holds_and_who_asked(
    client: int, start: Callable[[Bench, int], str]
) -> None:
    bench = held()
    assert start(bench, client) == (
        f"client {HOLDER} holds the lease (inspection), and client {client} asked"
    )
    assert bench.replies[-1].remedies == (Remedy.WAIT_FOR_LEASE,)
    assert bench.state.mode is Mode.IDLE


@pytest.mark.parametrize("client", [OTHER, ROS])
def test_the_holder_alone_starts_and_steers(client: int) -> None:
    bench = held()
    assert drive(bench, HOLDER) == ""
    assert "holds the lease" in drive(bench, client, replacing=True)
    assert drive(bench, HOLDER, replacing=True) == ""
    assert bench.state.reason == f"requested by client {HOLDER}: a reason"


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
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


@pytest.mark.parametrize(
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
