"""Ordinary steps in a row with the messages among them: each comparison takes many at once.

Almost all of a recording is such: ticks that send one command at most, measurements, and the
messages of both. What is not ordinary stands between two runs, and is compared on its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
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
from robotctl.rerun.batch import Batch
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

    __slots__ = ("_items", "_read", "by_kind", "messages", "steps")

    def __init__(
        self,
        read: Sequence[Step | Message],
        steps: list[Agreed],
        messages: defaultdict[str | None, list[Message]],
    ) -> None:
        """Take what was read; of that the `steps` as decided, and the messages by topic."""
        self._read = read
        self._items: list[Agreed | Message] | None = None
        self.steps = steps
        self.messages = messages
        self.by_kind: defaultdict[type[Event], list[Agreed]] = defaultdict(list)
        for each in steps:
            self.by_kind[type(each.event)].append(each)

    @property
    def items(self) -> list[Agreed | Message]:
        """Steps and messages in the order of writing."""
        if self._items is None:
            steps = iter(self.steps)
            self._items = [
                each if isinstance(each, Message) else next(steps) for each in self._read
            ]
        return self._items

    def has_only_ordinary_steps(self) -> bool:
        """Return whether each step is ordinary."""
        return all(
            kind in MEASUREMENTS and not any(step.effects for step in steps)
            for kind, steps in self.by_kind.items()
            if kind is not Tick
        ) and all(map(_is_ordinary_tick, self.by_kind[Tick]))

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


def ordinary_runs(batch: Batch, agreed: list[Agreed]) -> Iterator[OrdinaryRun | Single]:
    """Yield the runs of a batch, and what stands between them.

    `agreed` are the first steps of the batch as a kernel decides them.
    """
    run = OrdinaryRun(batch.items, agreed, batch.messages)
    if len(agreed) < len(batch.steps) or not run.has_only_ordinary_steps():
        yield from _cut(batch, agreed)
    elif batch.items:
        yield run
    if batch.end is not None:
        yield batch.end, batch.end_log_times, None


def _cut(batch: Batch, agreed: Sequence[Agreed]) -> Iterator[OrdinaryRun | Single]:
    """Yield the runs of a batch, and the steps between them."""
    following, times = iter(agreed), iter(batch.log_times)
    read: list[Step | Message] = []
    steps: list[Agreed] = []
    messages: defaultdict[str | None, list[Message]] = defaultdict(list)
    for item in batch.items:
        if isinstance(item, Message):
            read.append(item)
            messages[item.topic].append(item)
            continue
        log_times, each = next(times), next(following, None)
        if each is not None and _is_ordinary(each):
            read.append(item)
            steps.append(each)
            continue
        if read:
            yield OrdinaryRun(read, steps, messages)
            read, steps, messages = [], [], defaultdict(list)
        yield item, log_times, each
    if read:
        yield OrdinaryRun(read, steps, messages)


def _is_ordinary(step: Agreed) -> bool:
    if type(step.event) is Tick:
        return _is_ordinary_tick(step)
    return type(step.event) in MEASUREMENTS and not step.effects


def _is_ordinary_tick(tick: Agreed) -> bool:
    effects = tick.effects
    return not effects or (len(effects) == 1 and type(effects[0]) is PublishTwist)
