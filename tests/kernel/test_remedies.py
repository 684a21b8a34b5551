"""A stop and a refusal carry their cause and their remedies as data, without a command line."""

from __future__ import annotations

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.remedies import RESETTING, Remedy
from robotctl.kernel.safety import RULES, Rule, remedies_for, remedies_to_move
from robotctl.kernel.state import State
from robotctl.kernel.types import Cause, DriveEnded, FaultReported, ModeChanged
from robotctl.testing.kernels import Bench, in_mode, moving, reset, stopping


def effects_of(bench: Bench, kind: type) -> list[object]:
    return [effect for effect in bench.effects if isinstance(effect, kind)]


def test_a_fault_names_its_cause_in_the_change_of_mode_and_at_the_end_of_the_drive() -> None:
    bench = moving()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    changed, ended = effects_of(bench, ModeChanged)[-1], effects_of(bench, DriveEnded)[-1]
    assert isinstance(changed, ModeChanged)
    assert isinstance(ended, DriveEnded)
    assert (
        (changed.reason, changed.cause)
        == (ended.reason, ended.cause)
        == (
            "KeyError",
            Cause.TASK_DIED,
        )
    )


def test_a_change_of_mode_without_a_fault_has_no_cause() -> None:
    bench = stopping()
    bench.run(60)
    changed, ended = effects_of(bench, ModeChanged)[-1], effects_of(bench, DriveEnded)[-1]
    assert isinstance(changed, ModeChanged)
    assert isinstance(ended, DriveEnded)
    assert changed.mode is Mode.IDLE
    assert (changed.cause, ended.cause) == (None, None)


def test_a_request_that_waits_for_a_ramp_is_told_what_to_do_about_a_fault() -> None:
    bench = stopping()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    (refused,) = (reply for reply in bench.replies if not reply.ok)
    assert refused.message == "the mode became ERROR: KeyError"
    assert refused.remedies == (Remedy.READ_LOG_AND_RESTART,)


def test_a_cause_that_is_not_gone_is_told_with_its_remedy() -> None:
    bench = moving()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    bench.request(Mode.IDLE)
    assert bench.replies[-1].message == "the cause of ERROR is not gone: KeyError"
    assert bench.replies[-1].remedies == (Remedy.READ_LOG_AND_RESTART,)


def test_a_moving_robot_must_be_stopped_first() -> None:
    bench = in_mode(Mode.MOVING)
    bench.drive()
    assert bench.replies[-1].remedies == (Remedy.STOP_OR_REPLACE,)
    assert not reset(bench)
    assert bench.replies[-1].remedies == (Remedy.STOP_FIRST,)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.cause.value)
def test_the_last_remedy_before_a_robot_moves_again_is_a_reset(rule: Rule) -> None:
    remedies = remedies_to_move(rule.cause)
    assert remedies_for(rule.cause) == remedies[:1]
    assert remedies[-1] in RESETTING
    assert not RESETTING.intersection(remedies[:-1])


def test_a_mode_without_a_cause_has_no_remedy() -> None:
    assert remedies_for(State().cause) == ()
