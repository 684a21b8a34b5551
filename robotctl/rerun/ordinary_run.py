"""Ordinary steps in a row with the messages among them: each comparison takes many at once.

Almost all of a recording is such: ticks that send one command at most, measurements, and the
messages of both. What is not ordinary stands between two runs, and is compared on its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterable, Iterator
from typing import Final

from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    PublishTwist,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)
from robotctl.recording.read.messages import Message
from robotctl.rerun.agreed import Agreed
from robotctl.rerun.clock_changes import CLOCK_NS
from robotctl.rerun.journal_steps import Item, LogTimes, Step

MEASUREMENTS: Final = frozenset(
    {OdomReceived, BatteryReceived, ScanReceived, GuardedCommandReceived, SafetyInputReceived}
)
"""The events that are ordinary without an effect. Each is stamped when it is received."""

Single = tuple[Item, LogTimes, Agreed | None]
"""An item that is compared on its own; with a step what a kernel decided, if it agrees."""


class OrdinaryRun:
    """Ordinary steps and messages: in the order of writing, and by kind."""

    __slots__ = ("by_kind", "items", "messages", "steps")

    def __init__(self) -> None:
        self.items: list[Agreed | Message] = []
        self.steps: list[Agreed] = []
        self.by_kind: defaultdict[type[Event], list[Agreed]] = defaultdict(list)
        self.messages: defaultdict[str | None, list[Message]] = defaultdict(list)
        """The messages by topic."""

    def last_step(self) -> Agreed | None:
        """Return the last step; odometry does not count."""
        others = (step for step in reversed(self.steps) if type(step.event) is not OdomReceived)
        return next(others, None)

    def keeps_clock(self, offset_ns: int | None) -> bool:
        """Return whether the wall clock was not set in this run.

        `offset_ns` is wall clock - steady clock before it, None if that is not known.
        """
        offsets = [step.log_times[0] - step.event.t_ns for step in self.steps]
        if offset_ns is not None:
            offsets.append(offset_ns)
        return max(offsets) - min(offsets) <= CLOCK_NS


def ordinary_runs(
    batch: Iterable[tuple[Item, LogTimes]], agreed: Iterable[Agreed], topics: Container[str]
) -> Iterator[OrdinaryRun | Single]:
    """Yield the runs of a batch, and what stands between them.

    `agreed` are the first steps of the batch as a kernel decides them. Messages of other `topics`
    are not ordinary.
    """
    following = iter(agreed)
    run = OrdinaryRun()
    for item, log_times in batch:
        each: Agreed | None = None
        if isinstance(item, Message):
            if item.topic in topics:
                run.items.append(item)
                run.messages[item.topic].append(item)
                continue
        elif isinstance(item, Step):
            each = next(following, None)
            if each is not None and _is_ordinary(each):
                run.items.append(each)
                run.steps.append(each)
                run.by_kind[type(each.event)].append(each)
                continue
        if run.items:
            yield run
            run = OrdinaryRun()
        yield item, log_times, each
    if run.items:
        yield run


def _is_ordinary(step: Agreed) -> bool:
    kind, effects = type(step.event), step.effects
    if not effects:
        return kind is Tick or kind in MEASUREMENTS
    return kind is Tick and len(effects) == 1 and type(effects[0]) is PublishTwist
