"""The shadow of a running kernel: it decides after the driving kernel, and commands nothing."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

from robotctl.ipc.shadow_answers import DisagreementAnswer, ShadowFacts
from robotctl.kernel.codec import to_json
from robotctl.kernel.shadow import Disagreement, Shadow, contrast
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.types import Effect, Event
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.journal import (
    NO_EFFECT,
    SHADOW_FAILED,
    EntryKind,
    JournalEntry,
    encode,
)
from robotctl.recording.format.metadata_names import MADE_BY

_log = logging.getLogger(__name__)

SLOW_NS = 25_000_000
"""A longer step is slow: the next tick waits for it, and a gap of 50 ms between ticks may stop a
robot. To plan a path of 2,000 points takes 16 ms."""

MAX_SLOW_STEPS = 3
"""This number of slow steps in a row switches the shadow off; a single one may only have been
preempted."""

MAX_FAILURE = 300
"""Characters of the sentence about a failure."""


class HandledStep(NamedTuple):
    """A step of the driving kernel, after its effects were carried out.

    `seq` is the number of the event in the journal, and `state` the state after it.
    """

    seq: int
    event: Event
    effects: tuple[Effect, ...]
    state: State


class ShadowRun:
    """The shadow, and the record of what it decides differently; in the loop's thread.

    Any failure switches it off until the restart. The driving kernel never waits for it.
    """

    def __init__(
        self,
        shadow: Shadow,
        file: str,
        digest: str,
        write: Callable[[bytes], None],
        now_ns: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        """Run a shadow whose parameters are from `file` and have this digest.

        `write(serialized)` is called for each entry of the record; `now_ns()` times the steps.
        """
        self._shadow = shadow
        self._file = file
        self._digest = digest
        self._write = write
        self._now_ns = now_ns
        self._next_seq = 0
        self._failure = ""
        self._slow_steps = self._slow_in_a_row = 0

    def take(self, steps: Iterable[HandledStep]) -> None:
        """Decide on the events of these steps; this never raises."""
        for step in steps:
            if not self._failure:
                self._take(step)

    def snapshot(self, t_ns: int) -> None:
        """Write the shadow's parameters and state, from which a re-run of a file can start.

        This never raises.
        """
        if self._failure:
            return
        snapshot = Snapshot(MADE_BY, self._shadow.params, self._shadow.state)
        try:
            self._add(self._next_seq, t_ns, EntryKind.SNAPSHOT, "Snapshot", to_json(snapshot))
        except Exception as error:  # noqa: BLE001 - the robot is driven without the shadow
            self._end(self._next_seq, t_ns, _failure(error))

    def warning(self) -> str:
        """Return why the shadow is off, "" while it decides."""
        return f"the shadow is off until the next start: {self._failure}" if self._failure else ""

    def facts(self) -> ShadowFacts:
        """Return the shadow's part of the status."""
        shadow, now_ns = self._shadow, time.monotonic_ns()
        since_ns = None if self._failure else shadow.apart_since_ns
        return {
            "file": self._file,
            "digest": self._digest,
            "failure": self._failure,
            "mode": shadow.state.mode.name,
            "reason": shadow.state.reason,
            "steps": shadow.steps,
            "slow_steps": self._slow_steps,
            "differing": shadow.differing,
            "aspects": {each.value: count for each, count in shadow.by_aspect.items()},
            "apart_s": None if since_ns is None else (now_ns - since_ns) / NS_PER_S,
            "first": _answer(shadow.first, now_ns),
            "last": _answer(shadow.last, now_ns),
        }

    def _take(self, step: HandledStep) -> None:
        began_ns = self._now_ns()
        try:
            effects = self._shadow.step(step.event, step.effects, step.state)
            if effects is not None:
                self._record(step, effects)
        except Exception as error:  # noqa: BLE001 - the robot is driven without the shadow
            self._end(step.seq, step.event.t_ns, _failure(error))
            return
        self._next_seq = step.seq + 1
        if self._now_ns() - began_ns <= SLOW_NS:
            self._slow_in_a_row = 0
            return
        self._slow_steps += 1
        self._slow_in_a_row += 1
        if self._slow_in_a_row == MAX_SLOW_STEPS:
            failure = f"{MAX_SLOW_STEPS} steps in a row took more than {SLOW_NS / 1e6:g} ms"
            self._end(step.seq, step.event.t_ns, failure)

    def _record(self, step: HandledStep, effects: Sequence[Effect]) -> None:
        t_ns = step.event.t_ns
        for effect in effects:
            name = type(effect).__name__
            self._add(step.seq, t_ns, EntryKind.EFFECT, name, to_json(effect))
        if not effects:
            self._add(step.seq, t_ns, EntryKind.EFFECT, NO_EFFECT, "{}")

    def _end(self, seq: int, t_ns: int, failure: str) -> None:
        self._failure = failure
        with suppress(Exception):  # it may be the record that fails
            data = f'{{"failure":{to_json(self._failure)}}}'
            self._add(seq, t_ns, EntryKind.EFFECT, SHADOW_FAILED, data)
        _log.warning("%s", self.warning())

    def _add(self, seq: int, t_ns: int, kind: EntryKind, name: str, data: str) -> None:
        self._write(encode(JournalEntry(seq, t_ns, kind, name, data)))


def _failure(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:MAX_FAILURE]


def _answer(found: Disagreement | None, now_ns: int) -> DisagreementAnswer | None:
    if found is None:
        return None
    driving, shadow = contrast(found.driving, found.shadow)
    return {
        "ago_s": (now_ns - found.t_ns) / NS_PER_S,
        "event": type(found.event).__name__,
        "driving": driving,
        "shadow": shadow,
        "aspects": [each.value for each in found.aspects],
    }
