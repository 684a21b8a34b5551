"""All that a check compares with the decisions of a journal, taken step by step."""

from __future__ import annotations

from collections.abc import Callable

from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import Effect, Event, OdomReceived
from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.command_bytes import command_topic
from robotctl.rerun.command_check import CommandCheck
from robotctl.rerun.ending import Ending, JournalEnd
from robotctl.rerun.input_check import input_checks
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.measurement_order import MeasurementOrder
from robotctl.rerun.safety_input_check import SafetyInputChecks
from robotctl.rerun.service_check import ServiceChecks
from robotctl.rerun.stalls import RecordedStalls
from robotctl.rerun.status_check import StatusCheck
from robotctl.rerun.tick_schedule import TickSchedule


class Comparisons:
    """The invariants, and the comparisons of commands, inputs, services and statuses."""

    def __init__(self, report: Report, info: RecordingInfo, journal_topic: str) -> None:
        self._report = report
        clock = self._clock = ClockChanges()
        self.invariants = Invariants()
        self._ticks = TickSchedule()
        self._order = MeasurementOrder()
        self._commands = CommandCheck(report, clock)
        self._command_topic = command_topic(info, journal_topic)
        self._inputs = input_checks(report, info, journal_topic)
        self._stalls = RecordedStalls()
        self._safety_inputs = SafetyInputChecks(report, info, journal_topic, self._stalls)
        self._services = ServiceChecks(report, info, journal_topic, clock)
        self._status = StatusCheck(report, info, journal_topic, clock)

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return for each compared topic what takes its messages."""
        readers = self._inputs.readers() | self._services.readers()
        readers |= self._safety_inputs.readers()
        if self._command_topic is not None:
            readers[self._command_topic] = self._commands.message
        if self._status.topic is not None:
            readers[self._status.topic] = self._status.message
        return readers

    def step_before_snapshot(self, event: Event, effects: tuple[Effect, ...]) -> None:
        """Take a step of a kernel that is not known."""
        self._commands.step(event, effects, (0, 0, 0))

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Continue from a snapshot, with its time by the steady clock and since the epoch."""
        has_proof = snapshot.proof is not None
        self.invariants.snapshot(snapshot)
        self._clock.begin(t_ns, log_ns)
        self._ticks.begin(snapshot.params.rate_hz)
        self._commands.snapshot(snapshot)
        self._inputs.snapshot(has_proof)
        self._safety_inputs.snapshot(has_proof)
        self._services.snapshot(has_proof, log_ns)
        self._status.snapshot(snapshot, t_ns, log_ns)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Take an event with its effects, the number of its entry, and when it was handled."""
        self._order.step(event, seq)
        self._stalls.step(event)
        self._inputs.step(event, seq)
        self._safety_inputs.step(event, seq)
        self._status.step(event, effects, moments)
        if not effects and isinstance(event, OdomReceived):
            return  # most steps are so
        self._ticks.step(event, seq)
        self._commands.step(event, effects, moments)
        self._services.step(event, seq, effects, moments)
        self.invariants.step(seq, event, effects)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self.invariants.stop()
        self._ticks.stop()
        self._order.stop()
        self._commands.stop()
        self._inputs.stop()
        self._safety_inputs.stop()
        self._services.stop()
        self._status.stop()

    def end(self, ending: Callable[[str | None], Ending], end_ns: int, log_ns: int) -> None:
        """Report what differs; the journal ends at `end_ns`, since the epoch at `log_ns`.

        `ending(topic)` tells how the recording ends for a topic.
        """
        self._ticks.stop()
        for found in self._ticks.missing:
            self.invariants.violate(f"{found.ticks} ticks are missing before entry {found.seq}")
        if swapped := self._order.swapped:
            text = f"{swapped} measurements are earlier than one before them"
            self.invariants.violate(f"{text}, the first is entry {self._order.first_seq}")
        self._commands.end(self.invariants, ending(self._command_topic))
        stalled_ns = self._stalls.recent_ns(end_ns)
        moment = JournalEnd(end_ns, log_ns, stalled_ns, self._clock.has_changed)
        self._inputs.end(self.invariants, ending, moment)
        self._safety_inputs.end(self.invariants, ending, moment)
        self._services.end(self.invariants, ending, end_ns, log_ns)
        self._status.end(self.invariants, ending(self._status.topic), log_ns)
        if self._clock.note and ending(None).is_own:
            self._report.notes.append(self._clock.note)
