"""A shadow beside a Control changes no command and no journal, and fails alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from robotctl.cdr.motion import encode_twist
from robotctl.daemon.control.dispatcher import Control
from robotctl.daemon.control.journal_writer import Journal
from robotctl.daemon.control.pending_requests import PendingRequests
from robotctl.daemon.control.shadow_run import SLOW_NS, ShadowRun
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.shadow import Shadow
from robotctl.kernel.types import Effect, Event, PublishTwist, Tick
from robotctl.recording.format.journal import JournalEntry, decode
from robotctl.testing.kernels import Bench, moving
from tests.support import strategies

SLOW = replace(KernelParams(), limits=VelocityLimits(linear_mps=0.1))


class Driven:
    """A Control with or without a shadow, which begins while the robot moves."""

    def __init__(
        self,
        shadow: KernelParams | None = SLOW,
        now_ns: Callable[[], int] = lambda: 0,
        write: Callable[[bytes], None] | None = None,
        carry_out: Callable[[Effect], None] | None = None,
    ) -> None:
        self.journal: list[bytes] = []
        self.commands: list[bytes] = []
        self.record: list[JournalEntry] = []
        self.bench = moving(ticks=1)
        self.run: ShadowRun | None = None
        if shadow is not None:
            made = Shadow(shadow, self.bench.state, ("limits.linear_mps",))
            keep = write or (lambda serialized: self.record.append(decode(serialized)))
            self.run = ShadowRun(made, "slow.yaml", "0123", keep, now_ns)
        self.control = Control(
            Kernel(self.bench.kernel.params, self.bench.state),
            Journal(lambda serialized, seq: self.journal.append(serialized)),
            carry_out or self.carry_out,
            PendingRequests(),
            lambda error, where: None,
            shadow=self.run,
        )
        self.control.begin_file(self.bench.t_ns)

    def carry_out(self, effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            self.commands.append(encode_twist(effect.twist))

    def feed(self, events: list[Event]) -> None:
        for event in events:
            self.control.dispatch(event)

    @property
    def warning(self) -> str:
        assert self.run is not None
        return self.run.warning()


def drive_events(ticks: int) -> list[Event]:
    """Events of a robot that follows its reference, from the state of a new `Driven` on."""
    bench = moving(ticks=1)
    bench.events.clear()
    follow(bench, ticks)
    return bench.events


def follow(bench: Bench, ticks: int) -> None:
    for _ in range(ticks):
        assert bench.state.drive is not None
        bench.odometry(bench.state.drive.reference().pose)
        bench.tick()


@settings(max_examples=10, deadline=None, phases=[Phase.generate])
@given(st.data())
def test_commands_and_journal_are_the_same_bytes_with_and_without_a_shadow(
    data: st.DataObject,
) -> None:
    events = drive_events(5)
    for _ in range(6):
        now = st.just(events[-1].t_ns)
        events.append(data.draw(strategies.event(now, st.integers(100, 10_000))))
        events.append(Tick(events[-1].t_ns + 1))
    alone, beside = Driven(None), Driven()
    for driven in (alone, beside):
        driven.feed(events)
        driven.control.begin_file(events[-1].t_ns)  # the snapshot holds the whole state
    assert beside.commands == alone.commands
    assert beside.journal == alone.journal


def test_the_shadow_decides_after_all_events_that_wait() -> None:
    order: list[str] = []
    later: list[Event] = []

    def carry_out(effect: Effect) -> None:
        order.append("command")
        while later:
            driven.control.dispatch(later.pop())

    driven = Driven(write=lambda serialized: order.append("shadow"), carry_out=carry_out)
    events = drive_events(20)
    driven.feed(events)
    order.clear()
    later.append(Tick(events[-1].t_ns + 2))
    driven.control.dispatch(Tick(events[-1].t_ns + 1))
    assert order == ["command", "command", "shadow", "shadow"]


def test_only_what_differs_is_recorded_and_it_is_what_the_shadow_decides() -> None:
    driven, events = Driven(), drive_events(30)
    driven.feed(events)
    head, *record = driven.record
    assert (head.name, head.seq, record[0].name) == ("Snapshot", 0, "PublishTwist")
    journal = {entry.seq: entry for entry in map(decode, driven.journal)}
    assert {journal[entry.seq].name for entry in record} == {"Tick"}
    kernel, shadow = Kernel(SLOW, driven.bench.state), moving(ticks=1).kernel
    told = {entry.seq: entry.data for entry in record}
    numbers = [seq for seq, entry in journal.items() if entry.name in ("Tick", "OdomReceived")]
    for seq, event in zip(numbers, events, strict=True):
        mine, theirs = kernel.step(event), shadow.step(event)
        assert (seq in told) is (mine != theirs)
    assert 10 < len(record) < len(events)
    assert driven.run is not None
    facts = driven.run.facts()
    assert facts["differing"] == facts["aspects"]["command"] == len(record)
    assert facts["steps"] == len(events)
    assert facts["first"] is not None
    assert facts["first"]["shadow"] == "0.1 m/s, 0 rad/s"


def test_a_shadow_that_decides_nothing_where_the_robot_is_commanded_is_recorded() -> None:
    driven = Driven()
    assert driven.run is not None
    driven.run._shadow._kernel.step = lambda event: ()  # type: ignore[method-assign]
    driven.feed([Tick(driven.bench.t_ns + 1)])
    assert (driven.record[-1].name, driven.record[-1].seq) == ("Nothing", 1)


def test_a_shadow_that_fails_is_off_and_said_so(caplog: pytest.LogCaptureFixture) -> None:
    alone, driven, events = Driven(None), Driven(), drive_events(10)
    assert driven.run is not None

    def fail(event: Event) -> tuple[Effect, ...]:
        raise AssertionError("no such state")

    driven.feed(events[:4])
    driven.run._shadow._kernel.step = fail  # type: ignore[method-assign]
    driven.feed(events[4:])
    alone.feed(events)
    assert driven.commands == alone.commands
    assert driven.run.facts()["steps"] == 5
    said = "the shadow is off until the next start: AssertionError: no such state"
    assert driven.warning == said
    assert caplog.messages == [said]
    assert driven.record[-1].name == "Failed"
    driven.control.begin_file(events[-1].t_ns)
    assert driven.record[-1].name == "Failed"


def test_a_shadow_that_is_slow_in_three_steps_is_off() -> None:
    alone, events = Driven(None), drive_events(10)
    took_ns = (SLOW_NS + 1, SLOW_NS + 1, SLOW_NS, SLOW_NS + 1, SLOW_NS + 1, SLOW_NS + 1)
    times = iter([time_ns for took in took_ns for time_ns in (0, took)])
    driven = Driven(now_ns=lambda: next(times))
    driven.feed(events)
    alone.feed(events)
    assert driven.commands == alone.commands
    assert driven.warning.endswith(": 3 steps in a row took more than 25 ms")
    assert driven.run is not None
    facts = driven.run.facts()
    assert (facts["steps"], facts["slow_steps"]) == (6, 5)


def test_a_record_that_cannot_be_written_ends_the_shadow_alone() -> None:
    alone, events = Driven(None), drive_events(10)
    written = 0

    def write(serialized: bytes) -> None:
        nonlocal written
        written += 1
        if written > 1:
            raise MemoryError

    driven = Driven(write=write)
    driven.feed(events)
    alone.feed(events)
    assert driven.commands == alone.commands
    assert "MemoryError" in driven.warning


def test_a_first_entry_that_cannot_be_written_ends_the_shadow_alone() -> None:
    def write(serialized: bytes) -> None:
        raise OSError("no space")

    driven = Driven(write=write)
    driven.feed(drive_events(2))
    assert driven.commands
    assert driven.warning.endswith("OSError: no space")
