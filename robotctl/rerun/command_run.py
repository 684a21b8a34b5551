"""Finds which decided commands and which messages of an ordinary run belong to each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from robotctl.kernel.types import PublishTwist, Tick
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.read.messages import Message
from robotctl.rerun.agreed import Agreed
from robotctl.rerun.command_bytes import numbers_of, serialized
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.ordinary_run import OrdinaryRun
from robotctl.rerun.sequence_overlap import lockstep

LATE_NS: Final = NS_PER_S // 2
"""How far the time of a command may lie outside of its step."""

Decided = tuple[bytes, Moments]
"""The six numbers of a decided command, and the step that decided it."""


class CommandRun(NamedTuple):
    """The commands of a run: of those that are `common` each was sent within its step, as decided.

    The other messages are of decisions before the run or after it, and the reverse.
    """

    common: Sequence[bytes]
    decided_before: Sequence[Decided]
    decided_after: Sequence[Decided]
    sent_before: Sequence[Message]
    sent_after: Sequence[Message]


def command_run(run: OrdinaryRun, sent: Sequence[Message], number: int) -> CommandRun | None:
    """Return the commands of a run whose first one has this number, None if any differs."""
    steps = [step for step in run.by_kind[Tick] if step.effects]
    decided = [
        serialized(effect.twist)
        for step in steps
        for effect in step.effects
        if isinstance(effect, PublishTwist)
    ]
    numbers = [message.sequence for message in sent]
    parts = lockstep(numbers, [*range(number, number + len(decided))])
    if parts is None:
        return None
    of_sent, of_decided = parts
    common, messages = decided[of_decided], sent[of_sent]
    if common != [numbers_of(each.data) for each in messages]:
        return None
    if not all(map(_is_in_time, steps[of_decided], messages)):
        return None
    before, after = slice(of_decided.start), slice(of_decided.stop, None)
    return CommandRun(
        common,
        [(each, step.moments) for each, step in zip(decided[before], steps[before], strict=True)],
        [(each, step.moments) for each, step in zip(decided[after], steps[after], strict=True)],
        sent[: of_sent.start],
        sent[of_sent.stop :],
    )


def _is_in_time(step: Agreed, message: Message) -> bool:
    """Return whether the command of a step was sent within it."""
    begin_ns, end_ns = step.log_times
    return not end_ns or begin_ns - LATE_NS <= message.publish_ns <= end_ns + LATE_NS
