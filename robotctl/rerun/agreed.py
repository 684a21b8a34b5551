"""Steps in which the re-run kernel decides exactly what is recorded."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Final, NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.types import Effect, Event
from robotctl.rerun.journal_steps import LogTimes, Moments, Step
from robotctl.rerun.journal_values import read_effect, read_event
from robotctl.rerun.measured import Followed, MeasuredState

new_tuple: Final = tuple.__new__
"""Makes a named tuple in a third of the time of its class."""


class Agreed(NamedTuple):
    """A step that a kernel decides as it is recorded, and what is measured after it.

    `seq` is the number of the event's entry.
    """

    seq: int
    event: Event
    effects: tuple[Effect, ...]
    measured: MeasuredState
    log_times: LogTimes

    @property
    def moments(self) -> Moments:
        """When it was handled."""
        return self.event.t_ns, *self.log_times


def read_events(steps: Iterable[Step]) -> list[Event]:
    """Return the events of many steps, up to the first that cannot be read."""
    events: list[Event] = []
    with suppress(UnreadableFile):
        for step in steps:
            events.append(read_event(step.event))  # noqa: PERF401 - an error keeps the others
    return events


def followed_steps(
    followed: Followed, steps: Iterable[Step], log_times: Iterable[LogTimes]
) -> list[Agreed]:
    """Return steps that were re-run elsewhere, up to the first that cannot be read."""
    agreed: list[Agreed] = []
    with suppress(UnreadableFile):
        for step, times in zip(steps, log_times, strict=False):
            event, seq = read_event(step.event), step.event.seq
            effects = tuple([read_effect(effect) for effect in step.effects])
            measured = followed.step(seq, event)
            agreed.append(new_tuple(Agreed, (seq, event, effects, measured, times)))
    return agreed
