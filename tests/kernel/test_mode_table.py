"""The mode table of docs/architecture.md, written a second time and compared with the kernel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from types import MappingProxyType

import pytest

from robotctl.kernel import kernel
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode, Transition, Trigger
from robotctl.kernel.types import (
    Cause,
    CommandPublishersSeen,
    FaultReported,
    ModeChanged,
    Phase,
    Reply,
    ResetRequested,
)
from robotctl.testing.kernels import Bench, in_mode

IDLE, MOVING, ERROR, STOP = Mode

# (mode, request): what follows in a healthy robot, and what while a fault is present
TABLE: Mapping[tuple[Mode, str], tuple[str, str]] = {
    (IDLE, "idle"): ("IDLE", "IDLE"),
    (IDLE, "moving"): ("MOVING", "refused"),
    (IDLE, "error"): ("ERROR", "ERROR"),
    (IDLE, "emergency stop"): ("EMERGENCY_STOP", "EMERGENCY_STOP"),
    (IDLE, "reset"): ("IDLE", "IDLE"),
    (MOVING, "idle"): ("ramps down", "ramps down"),
    (MOVING, "moving"): ("MOVING", "MOVING"),
    (MOVING, "error"): ("ERROR", "ERROR"),
    (MOVING, "emergency stop"): ("EMERGENCY_STOP", "EMERGENCY_STOP"),
    (MOVING, "reset"): ("refused", "refused"),
    (ERROR, "idle"): ("IDLE", "refused"),
    (ERROR, "moving"): ("refused", "refused"),
    (ERROR, "error"): ("ERROR", "ERROR"),
    (ERROR, "emergency stop"): ("EMERGENCY_STOP", "EMERGENCY_STOP"),
    (ERROR, "reset"): ("IDLE", "refused"),
    (STOP, "idle"): ("IDLE", "refused"),
    (STOP, "moving"): ("refused", "refused"),
    (STOP, "error"): ("refused", "refused"),
    (STOP, "emergency stop"): ("EMERGENCY_STOP", "EMERGENCY_STOP"),
    (STOP, "reset"): ("IDLE", "refused"),
}

REQUEST_NUMBERS = {"idle": 0, "moving": 1, "error": 2, "emergency stop": 3}


def outcome(bench: Bench, request: str) -> str:
    """Return what the robot does on `request`, and check what holds in every mode."""
    before, already = bench.state, len(bench.replies)
    if request == "reset":
        effects = bench.give(ResetRequested(bench.t_ns, bench.new_request_id(), "test"))
    else:
        effects = bench.request(REQUEST_NUMBERS[request])
    replies = bench.replies[already:]
    after = bench.state
    changes = [effect for effect in effects if isinstance(effect, ModeChanged)]
    assert len(changes) == (before.mode is not after.mode)
    assert (after.cause is None) == (after.mode in (Mode.IDLE, Mode.MOVING))
    if before.mode is after.mode:
        assert after.drive == before.drive
    if not replies:
        assert bench.state.mode is before.mode
        assert bench.state.phase is Phase.STOPPING
        return "ramps down"
    (reply,) = replies
    assert isinstance(effects[-1], Reply)
    assert reply.mode is bench.state.mode
    if not reply.ok:
        assert bench.state == before
        return "refused"
    return bench.state.mode.name


def faulty(mode: Mode) -> Bench:
    """Return a robot in `mode` with a fault that does not itself change the mode."""
    bench = in_mode(mode)
    if mode in (Mode.ERROR, Mode.EMERGENCY_STOP):
        bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "a task died"))
    elif mode is Mode.IDLE:
        bench.give(CommandPublishersSeen(bench.t_ns, ("/teleop",)))
    else:
        bench.t_ns += 600_000_000  # odometry is lost, but no tick has found out yet
    assert bench.state.mode is mode
    return bench


def behaviour() -> dict[tuple[Mode, str], tuple[str, str]]:
    """Return the table as the kernel behaves."""
    return {
        (mode, request): (outcome(in_mode(mode), request), outcome(faulty(mode), request))
        for mode in Mode
        for request in (*REQUEST_NUMBERS, "reset")
    }


def test_the_kernel_does_what_the_table_says() -> None:
    assert behaviour() == TABLE


def test_every_mode_answers_every_trigger() -> None:
    assert set(TRANSITIONS) == {(mode, trigger) for mode in Mode for trigger in Trigger}


def test_the_numbers_are_those_of_the_ros_interface() -> None:
    assert {mode.name: mode.value for mode in Mode} == {
        "IDLE": 0,
        "MOVING": 1,
        "ERROR": 2,
        "EMERGENCY_STOP": 3,
    }
    assert [REQUESTS[mode].value for mode in Mode] == [
        f"request {name}" for name in REQUEST_NUMBERS
    ]


def test_a_fault_never_leads_to_a_milder_mode() -> None:
    severity = {Mode.IDLE: 0, Mode.MOVING: 0, Mode.ERROR: 1, Mode.EMERGENCY_STOP: 2}
    for mode in Mode:
        for trigger, least in ((Trigger.FAULT_ERROR, 1), (Trigger.FAULT_EMERGENCY_STOP, 2)):
            target = TRANSITIONS[mode, trigger].target
            assert severity[target] == max(severity[mode], least), (mode, trigger)


def mutants() -> Iterator[tuple[str, tuple[Mode, Trigger], Transition]]:
    """Yield every change of one row that matters: another guard or another target.

    The target does not matter where a request is refused, starts a drive or begins a ramp.
    """
    asked = (*REQUESTS.values(), Trigger.RESET)
    for key, row in TRANSITIONS.items():
        mode, trigger = key
        if trigger not in asked:
            continue
        for guard in Guard:
            for target in Mode:
                other = Transition(target, guard)
                if guard is row.guard and (
                    target is row.target or guard not in (Guard.NONE, Guard.CAUSE_GONE)
                ):
                    continue
                yield f"{mode.name}, {trigger.value}: {target.name} {guard.value}", key, other


def test_every_mutated_row_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    survivors = []
    for name, (mode, trigger), mutant in mutants():
        request = "reset" if trigger is Trigger.RESET else trigger.value.removeprefix("request ")
        healthy, ill = in_mode(mode), faulty(mode)
        mutated = MappingProxyType({**TRANSITIONS, (mode, trigger): mutant})
        with monkeypatch.context() as patch, suppress(AssertionError):
            patch.setattr(kernel, "TRANSITIONS", mutated)
            if (outcome(healthy, request), outcome(ill, request)) == TABLE[mode, request]:
                survivors.append(name)
    assert len(list(mutants())) == 362
    assert not survivors


def test_a_standstill_ends_a_ramp_in_idle() -> None:
    assert TRANSITIONS[Mode.MOVING, Trigger.STANDSTILL] == Transition(Mode.IDLE)
