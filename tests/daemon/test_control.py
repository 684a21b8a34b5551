"""Control handles events in order, journals each, and carries out effects despite failures."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

from robotctl.daemon.control.dispatcher import Control, Journal, PendingRequests
from robotctl.daemon.shutdown import send_zero, stand_still
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    Effect,
    LatchEmergencyStop,
    ModeRequested,
    PublishTwist,
    Reply,
    ResetRequested,
    Tick,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.rerun.rerun import first_divergence
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.testing.kernels import moving
from tests.support.waiting import loop_until


class Bench:
    """A Control whose effects a test can redirect."""

    def __init__(self, params: KernelParams | None = None, state: State | None = None) -> None:
        self.entries: list[JournalEntry] = []
        self.done: list[Effect] = []
        self.failures: list[str] = []
        self.do: Callable[[Effect], None] = self.done.append
        self.requests = PendingRequests()
        self.control = Control(
            Kernel(params or KernelParams(), state),
            Journal(lambda serialized, seq: self.entries.append(decode(serialized))),
            lambda effect: self.do(effect),
            self.requests,
            lambda error, where: self.failures.append(where),
        )
        self.control.journal_snapshot(0)

    @property
    def names(self) -> list[str]:
        """The names of the journal entries."""
        return [entry.name for entry in self.entries]

    def published(self) -> int:
        """Return the number of commands so far."""
        return self.names.count("PublishTwist")


def test_an_effect_is_journaled_after_it_was_carried_out() -> None:
    bench = Bench()
    seen: list[int] = []
    bench.do = lambda effect: seen.append(len(bench.entries))
    bench.control.dispatch(Tick(1))
    assert bench.names == ["Snapshot", "Tick", "PublishTwist"]
    assert seen == [2]


def test_a_snapshot_stands_in_the_journal_every_10_s() -> None:
    bench = Bench()
    for tick in range(1, 121):
        bench.control.dispatch(Tick(tick * 250_000_000))
    at_s = [entry.t_ns / 1e9 for entry in bench.entries if entry.kind is EntryKind.SNAPSHOT]
    assert at_s == [0.0, 10.0, 20.0, 30.0]
    assert first_divergence(bench.entries) is None


def test_what_an_effect_dispatches_waits_its_turn() -> None:
    bench = Bench()

    def carry_out(effect: Effect) -> None:
        if isinstance(effect, LatchEmergencyStop):
            bench.control.dispatch(Tick(2))

    bench.do = carry_out
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    assert bench.names[-3:] == ["Reply", "Tick", "PublishTwist"]
    assert first_divergence(bench.entries) is None


def test_the_effects_after_a_failed_one_are_carried_out() -> None:
    bench = Bench()

    def fail_to_publish(effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            raise OSError("no network")
        bench.done.append(effect)

    bench.do = fail_to_publish
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    assert [type(effect).__name__ for effect in bench.done] == [
        "LatchEmergencyStop",
        "ModeChanged",
        "Reply",
    ]
    reply = bench.done[-1]
    assert isinstance(reply, Reply)
    assert (reply.ok, reply.mode) == (False, Mode.EMERGENCY_STOP)
    assert reply.message.endswith("but PublishTwist failed: no network")
    assert first_divergence(bench.entries) is None


def test_a_lasting_failure_is_reported_once() -> None:
    bench = Bench()
    broken = True

    def carry_out(effect: Effect) -> None:
        if broken:
            raise OSError("no network")

    bench.do = carry_out
    for t_ns in range(1, 4):
        bench.control.dispatch(Tick(t_ns))
    assert bench.failures == ["PublishTwist failed: no network"]
    broken = False
    bench.control.dispatch(Tick(4))
    broken = True
    bench.control.dispatch(Tick(5))
    assert len(bench.failures) == 2


async def test_a_cancelled_request_is_removed() -> None:
    bench = Bench()
    bench.requests.expect_reply(1).cancel()
    bench.requests.answer(Reply(1, True, "", Mode.IDLE))
    bench.do = lambda effect: bench.requests.answer(effect) if isinstance(effect, Reply) else None
    reply = await bench.control.request(ResetRequested(1, 2, "test"))
    assert (reply.request_id, reply.ok) == (2, True)
    await loop_until(lambda: not bench.requests._replies)


async def test_no_motion_begins_while_the_daemon_ends() -> None:
    bench = Bench()
    bench.do = lambda effect: bench.requests.answer(effect) if type(effect) is Reply else None
    await stand_still(bench.control, bench.published)
    assert bench.names[-2:] == ["Tick", "PublishTwist"]
    reply = await bench.control.request(ModeRequested(time.monotonic_ns(), 1, 1, "test"))
    assert not reply.ok
    assert "the daemon is stopping" in reply.message
    assert first_divergence(bench.entries) is None


def test_the_journal_of_a_daemon_that_fails_tells_that_it_ends() -> None:
    bench, velocity = Bench(), SimpleNamespace(published=0)

    def publish(effect: Effect) -> None:
        velocity.published += isinstance(effect, PublishTwist)

    bench.do = publish
    send_zero(bench.control, cast(VelocityPublisher, velocity))
    assert bench.names[-3:] == ["FaultReported", "Tick", "PublishTwist"]
    assert '"cause":"daemon ends"' in bench.entries[-3].data


async def test_a_last_zero_that_fails_is_sent_again() -> None:
    bench, failures, sent = Bench(), iter([MemoryError()] * 3), []

    def publish(effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            for failure in failures:
                raise failure
            sent.append(effect.twist)

    bench.do = publish
    await stand_still(bench.control, lambda: len(sent))
    assert sent == [ZERO]


async def test_a_ramp_that_takes_too_long_is_cut() -> None:
    bench = Bench(moving().kernel.params, moving().state)
    bench.do = lambda effect: bench.requests.answer(effect) if type(effect) is Reply else None
    assert bench.control.state.command != ZERO
    await stand_still(  # without ticks
        bench.control,
        bench.published,
        ramp_down_s=0.01,
        now_ns=lambda: bench.control.state.tick_t_ns or 0,
    )
    assert bench.control.state.mode is Mode.ERROR
    assert bench.control.state.command == ZERO
    assert first_divergence(bench.entries) is None
