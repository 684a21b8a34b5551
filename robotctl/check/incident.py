"""Find the step that stopped the robot or refused a request, and the kernel's state then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robotctl.base.errors import UnreadableFile
from robotctl.check.commands import is_zero, numbers_of
from robotctl.check.journal import Gap, Step, decide, read_effect, read_event, read_snapshot, steps
from robotctl.check.topics import RobotTopics
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import Effect, Event, ModeChanged, ModeRequested, Phase, Reply
from robotctl.recording import Recording
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic

MAX_MESSAGES_AFTER = 2000
"""The maximum number of messages to search for the first zero command after a stop."""


class IncidentKind(StrEnum):
    """Why the robot stopped, or that a request was refused."""

    FAULT = "fault"
    """The kernel stopped the robot because of a fault."""

    STOP = "stop"
    """A request stopped the robot, or its drive was finished."""

    REFUSAL = "refusal"

    KILL = "kill"
    """The recording ends while the robot is MOVING, without a close."""


@dataclass(slots=True)
class Incident:
    """A step of the kernel (an event and its effects) that stopped the robot or refused a request.

    For KILL, it is the last recorded step. Times are steady [ns]; only `log_ns` (time of recording)
    and `zero_ns` (first zero command after the step) are since the epoch. None means not recorded.
    """

    kind: IncidentKind
    seq: int
    t_ns: int
    event: Event
    effects: tuple[Effect, ...]
    begin_ns: int
    snapshot_seq: int | None
    moving_since_ns: int | None
    log_ns: int = 0
    zero_ns: int | None = None
    params: KernelParams | None = None
    before: State | None = None
    after: State | None = None
    ramp: tuple[int, Event] | None = None
    """Begin and event of the ramp to this stop, or None."""

    next_change: tuple[int, ModeChanged] | None = None


@dataclass(frozen=True, slots=True)
class Searched:
    """The result of a search: the incident or None, and a sentence for each unreadable part."""

    incident: Incident | None
    missing: list[str]


def find_incident(
    path: Path,
    at_ns: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Searched:
    """Return the last incident of a recording, or the one nearest to `at_ns` since the epoch.

    Raises:
        UnreadableFile: The recording has no journal.
    """
    with Recording(path) as recording:
        topic = journal_topic(recording.info())
        if topic is None:
            raise UnreadableFile(f"{path} holds no journal of robotctl: it does not say why")
        search = _Search(recording, topic, at_ns)
        incident = search.run(on_progress)
        if incident is not None:
            _fill(recording, topic, incident)
    return Searched(incident, search.missing)


class _Search:
    """The first pass over the journal: it finds the step, and the next change of mode."""

    def __init__(self, recording: Recording, topic: str, at_ns: int | None) -> None:
        self._recording = recording
        self._topic = topic
        self._at_ns = at_ns
        self._log_ns = 0
        self._begin_ns: int | None = None
        self._snapshot_seq: int | None = None
        self._moving_since_ns: int | None = None
        self._mode: Mode | None = None
        self._last: Step | None = None
        self._best: Incident | None = None
        self._best_apart_ns = 0
        self.missing = list(recording.missing)

    def run(self, on_progress: Callable[[int, int], None]) -> Incident | None:
        """Return the incident, or None."""
        for item in steps(self._entries(on_progress)):
            try:
                if isinstance(item, Gap):
                    self.miss(item.text)
                    self._snapshot_seq = self._moving_since_ns = self._mode = None
                elif isinstance(item, Step):
                    self._step(item)
                else:
                    self._snapshot(item)
            except UnreadableFile as error:
                self.miss(str(error))
        if self._last is not None and self._mode is Mode.MOVING and self._recording.is_cut_off:
            self._consider(self._last, IncidentKind.KILL)
        return self._best

    def _entries(self, on_progress: Callable[[int, int], None]) -> Iterator[JournalEntry]:
        decoder = EntryDecoder(self._recording)
        for message in self._recording.in_order_written({self._topic}, self.miss, on_progress):
            self._log_ns = message.log_ns
            entry = decoder.decode(message.data)
            if self._begin_ns is None:
                self._begin_ns = entry.t_ns
            yield entry

    def _step(self, step: Step) -> None:
        t_ns, effects = step.event.t_ns, _telling(step)
        for effect in effects:
            if isinstance(effect, ModeChanged):
                if self._best is not None and self._best.next_change is None:
                    self._best.next_change = t_ns, effect
                if effect.mode is Mode.MOVING:
                    self._moving_since_ns = t_ns
                self._mode = effect.mode
        self._last = step
        kind = _kind(step, effects)
        if kind is not None:
            self._consider(step, kind)

    def _snapshot(self, entry: JournalEntry) -> None:
        state = read_snapshot(entry).state
        if self._snapshot_seq is None or state.phase is not Phase.STOPPING:
            self._snapshot_seq = entry.seq  # one within a ramp lacks its beginning
        if self._mode is None:
            self._mode = state.mode

    def _consider(self, step: Step, kind: IncidentKind) -> None:
        """Keep the step if it is later, or nearer to the wanted time, than the kept one."""
        apart_ns = 0 if self._at_ns is None else abs(self._log_ns - self._at_ns)
        if self._best is not None and apart_ns > self._best_apart_ns:
            return
        self._best_apart_ns = apart_ns
        self._best = Incident(
            kind=kind,
            seq=step.event.seq,
            t_ns=step.event.t_ns,
            event=read_event(step.event),
            effects=tuple(map(read_effect, step.effects)),
            begin_ns=self._begin_ns or 0,
            snapshot_seq=self._snapshot_seq,
            moving_since_ns=self._moving_since_ns,
        )

    def miss(self, sentence: str) -> None:
        """Add a sentence about an unreadable part."""
        note_missing(self.missing, sentence)


def _telling(step: Step) -> list[Effect]:
    """Return the mode changes and replies of a step."""
    names = (ModeChanged.__name__, Reply.__name__)
    return [read_effect(entry) for entry in step.effects if entry.name in names]


def _kind(step: Step, effects: list[Effect]) -> IncidentKind | None:
    for effect in effects:
        if isinstance(effect, ModeChanged):
            if effect.mode in (Mode.ERROR, Mode.EMERGENCY_STOP):
                asked = step.event.name == ModeRequested.__name__
                return IncidentKind.STOP if asked else IncidentKind.FAULT
            if effect.previous is Mode.MOVING:
                return IncidentKind.STOP
    if any(isinstance(effect, Reply) and not effect.ok for effect in effects):
        return IncidentKind.REFUSAL
    return None


def _fill(recording: Recording, topic: str, incident: Incident) -> None:
    """Fill in the states, the parameters and the ramp by a second pass over the journal."""
    kernel: Kernel | None = None
    for item in steps(_around(recording, topic, incident)):
        try:
            if isinstance(item, Gap):
                kernel = None
            elif isinstance(item, JournalEntry):
                kernel = read_snapshot(item).kernel()
            elif kernel is not None and item.event.seq <= incident.seq:
                _repeat(kernel, item.event, incident)
        except UnreadableFile:  # the states then stay unknown
            kernel = None


def _repeat(kernel: Kernel, entry: JournalEntry, incident: Incident) -> None:
    before, event = kernel.state, read_event(entry)
    decide(kernel, event)
    if entry.seq == incident.seq:
        incident.params, incident.before, incident.after = kernel.params, before, kernel.state
    elif kernel.state.phase is not Phase.STOPPING:
        incident.ramp = None
    elif before.phase is not Phase.STOPPING:
        incident.ramp = event.t_ns, event


def _around(recording: Recording, topic: str, incident: Incident) -> Iterator[JournalEntry]:
    """Yield the journal from the incident's snapshot on; fill in `log_ns` and `zero_ns`."""
    first = incident.seq if incident.snapshot_seq is None else incident.snapshot_seq
    commands = RobotTopics(recording.info(), topic).commands
    topics = {topic} if commands is None else {topic, commands}
    decoder, messages_after = EntryDecoder(recording), 0
    for message in recording.in_order_written(topics, lambda sentence: None):
        messages_after += bool(incident.log_ns)
        if message.topic == topic:
            entry = decoder.decode(message.data)
            if entry.seq == incident.seq:
                incident.log_ns = message.log_ns
            if entry.seq >= first:
                yield entry
        elif 0 < incident.log_ns <= message.publish_ns and is_zero(numbers_of(message.data)):
            incident.zero_ns = message.publish_ns
            return
        if messages_after > MAX_MESSAGES_AFTER:
            return
