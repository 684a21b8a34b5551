"""Checks the events in the metadata against the journal: stops, errors, and drives that ended."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from math import inf
from typing import Final, NamedTuple

from robotctl.kernel.types import Effect
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import RecordingInfo
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.metadata_names import CLIP_RECORD
from robotctl.recording.format.noted_events import noted_event
from robotctl.recording.format.recorded_events import ERRORS, RecordedEvent
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.ending import Ending
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Moments

APART_NS: Final = 2 * NS_PER_S
"""How far an event may be from its journal entry: both are made in one step."""

SAME_FIGURE: Final = 1e-9
"""How far figures may be apart: those of the journal are decided again, perhaps by another libc."""

_FIGURES: Final = (*(name for name in ERRORS if not name.startswith("true_")), "drive_s")


class _Noted(NamedTuple):
    """An event as the journal tells it: when its step was recorded, and when the next one."""

    event: RecordedEvent
    steady_ns: int
    next_log_ns: int


class EventRecords:
    """The events of a journal, and those in the metadata of its recording.

    The journal does not tell marks, nor the true errors of a simulated drive.
    """

    def __init__(self, report: Report, info: RecordingInfo, clock: ClockChanges) -> None:
        self._report = report
        self._clock = clock
        self._told = deque(each for each in info.events if each.kind is not EventKind.MARK)
        self._noted: deque[_Noted] = deque()
        self._is_known = True
        self._about = info.metadata.get(CLIP_RECORD, {})

    def step(self, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Take the effects of a step, and when it was handled."""
        steady_ns, log_ns, next_log_ns = moments
        for effect in effects:
            event = noted_event(effect, log_ns)
            if event is not None:
                self._noted.append(_Noted(event, steady_ns, next_log_ns))

    def stop(self) -> None:
        """Compare nothing: entries are missing."""
        self._is_known = False

    def end(self, invariants: Invariants, ending: Ending, end_ns: int) -> None:
        """Report the first difference; the journal ends at `end_ns` since the epoch."""
        if not (self._is_known and ending.is_own):
            return
        if difference := self._difference(*self._bounds(ending, end_ns)):
            ending.accuse(
                self._report, invariants, f"the events in the metadata differ: {difference}"
            )

    def _bounds(self, ending: Ending, end_ns: int) -> tuple[float, float]:
        """Return from when on and until when each event stands in both."""
        begin_ns: float = self._report.begin_log_ns
        if ending.is_clip:
            with suppress(KeyError, ValueError):
                begin_ns, end_ns = int(self._about["start_ns"]), int(self._about["end_ns"])
        elif ending.has_begin:
            begin_ns = -inf
        is_closed = ending.is_whole and ending.ledger is not None
        return begin_ns + APART_NS, inf if is_closed else end_ns - APART_NS

    def _difference(self, begin_ns: float, end_ns: float) -> str:
        """Return the first difference, "" if there is none."""
        told, noted = self._told, self._noted
        while told or noted:
            ours = noted[0].event if noted else None
            theirs = told[0] if told else None
            if ours and theirs and self._is_same(noted[0], theirs):
                told.popleft()
                noted.popleft()
                continue
            is_first = theirs is None or (ours is not None and ours.log_ns < theirs.log_ns)
            first = ours if is_first else theirs
            assert first is not None
            if begin_ns <= first.log_ns <= end_ns:
                return f"{_shown(theirs)}, in the journal {_shown(ours)}"
            (noted if is_first else told).popleft()
        return ""

    def _is_same(self, noted: _Noted, told: RecordedEvent) -> bool:
        event = noted.event
        text = event.text.encode(errors="backslashreplace").decode()  # as metadata holds it
        if (told.kind, told.text, told.laps) != (event.kind, text, event.laps):
            return False
        if not all(self._is_figure(getattr(event, n), getattr(told, n)) for n in _FIGURES):
            return False
        early_ns, late_ns = event.log_ns - told.log_ns, told.log_ns - noted.next_log_ns
        is_then = max(early_ns, late_ns) <= APART_NS
        return is_then or not event.log_ns or self._clock.is_near(noted.steady_ns)

    def _is_figure(self, ours: float | None, theirs: float | None) -> bool:
        if theirs is None:  # an error of 0 was not measured
            return not ours or not self._report.same_version
        return ours is not None and abs(ours - theirs) <= SAME_FIGURE


def _shown(event: RecordedEvent | None) -> str:
    if event is None:
        return "none"
    figures = ""
    if event.kind is EventKind.DRIVE_ENDED:
        known = {name: getattr(event, name) for name in _FIGURES}
        texts = [f"{name} {value:.4g}" for name, value in known.items() if value is not None]
        figures = f" of {', '.join([f'{event.laps} laps', *texts])}"
    seconds = event.log_ns / NS_PER_S
    return f"{event.kind.value}{figures} at {seconds:.3f} s since the epoch ({event.text[:80]})"
