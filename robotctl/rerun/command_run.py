"""Finds which decided commands and which messages of an ordinary run belong to each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from robotctl.kernel.types import PublishTwist, Tick
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.read.messages import Message
from robotctl.rerun.command_bytes import numbers_of, serialized
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.lockstep import lockstep
from robotctl.rerun.ordinary_run import OrdinaryRun

LATE_NS: Final = NS_PER_S // 2
"""How far the time of a command may lie outside of its step."""

Decided = tuple[bytes, Moments]
"""The six numbers of a decided command, and the step that decided it."""


class CommandRun(NamedTuple):
    """The commands of a run by number: each one `decided` was sent within its step, as decided.

    The other messages are of decisions before the run or after it, and the reverse.
    """

    decided: Sequence[Decided]
    decided_before: Sequence[Decided]
    decided_after: Sequence[Decided]
    sent_before: Sequence[Message]
    sent_after: Sequence[Message]


def command_run(run: OrdinaryRun, sent: Sequence[Message], number: int) -> CommandRun | None:
    """Return the commands of a run whose first one has this number, None if any differs."""
    decided = [
        (serialized(effect.twist), step.moments)
        for step in run.by_kind[Tick]
        for effect in step.effects
        if isinstance(effect, PublishTwist)
    ]
    numbers = [message.sequence for message in sent]
    parts = lockstep(numbers, [*range(number, number + len(decided))])
    if parts is None:
        return None
    of_sent, of_decided = parts
    common = decided[of_decided]
    if not _are_sent(common, sent[of_sent]):
        return None
    before, after = slice(of_decided.start), slice(of_decided.stop, None)
    return CommandRun(
        common, decided[before], decided[after], sent[: of_sent.start], sent[of_sent.stop :]
    )


def _are_sent(decided: Sequence[Decided], messages: Sequence[Message]) -> bool:
    """Return whether each message is that of a decision, and was sent within its step."""
    if [numbers for numbers, _ in decided] != [numbers_of(each.data) for each in messages]:
        return False
    return all(
        not end_ns or begin_ns - LATE_NS <= message.publish_ns <= end_ns + LATE_NS
        for (_, (_, begin_ns, end_ns)), message in zip(decided, messages, strict=True)
    )
