"""Reads a recording for a check: the journal as steps, and the compared topics, in their order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.journal_reader import EntryDecoder
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.entry_order import EntryOrder, Gap
from robotctl.rerun.journal_chain import JournalChain
from robotctl.rerun.journal_steps import Item, LogTimes, Step
from robotctl.rerun.recording_ends import RecordingEnds

Readers = Mapping[str, Callable[[Message], None]]
"""What reads the messages of each compared topic."""


class CheckReading:
    """One pass over a recording.

    `end_ns` is that of the last entry that was read; `chain` includes each entry up to it.
    """

    def __init__(
        self,
        recording: Recording,
        report: Report,
        ends: RecordingEnds,
        on_progress: Callable[[int, int], None],
    ) -> None:
        self._recording = recording
        self._report = report
        self._ends = ends
        self._on_progress = on_progress
        self._decoder = EntryDecoder(recording)
        self.chain = JournalChain()
        self.end_ns = 0
        self._log_ns: LogTimes = (0, 0)
        self._step: Step | None = None
        """The last step, of which effects may follow."""

    def items(self, topic: str, readers: Readers) -> Iterator[tuple[Item, LogTimes]]:
        """Yield what is read of the journal `topic`, with the log times of what was read before it.

        Messages of other topics go to their `readers` at once.

        Raises:
            UnreadableFile: The journal cannot be read.
        """
        order, last_ns = EntryOrder(), 0
        for message in self._recording.in_order_written(
            {topic, *readers}, self._report.miss, self._on_progress
        ):
            if message.topic != topic:
                readers[message.topic](message)
                continue
            entry = self._decoder.decode(message.data)
            self._note(entry, message)
            last_ns = message.log_ns
            if entry.kind is not EntryKind.EFFECT:
                self._log_ns = self._log_ns[1], last_ns
            for item in order.take(entry):
                yield from self._grouped(item)
        self._log_ns = self._log_ns[1], max(self._log_ns[1], last_ns)  # of the last step
        for item in order.rest():
            yield from self._grouped(item)
        yield from self._ended(is_cut=True)

    def _note(self, entry: JournalEntry, message: Message) -> None:
        if not self._report.begin_log_ns:
            self._ends.origin.first(message)
            self._report.begin_ns, self._report.begin_log_ns = entry.t_ns, message.log_ns
        self.end_ns = entry.t_ns
        self.chain.add(entry.seq, message.data)
        self._ends.entry(entry.seq)

    def _grouped(self, item: JournalEntry | Gap) -> Iterator[tuple[Item, LogTimes]]:
        """Add an effect to its step; yield the step before any other item, and that item."""
        if isinstance(item, Gap):
            yield from self._ended(is_cut=True)
            yield item, self._log_ns
        elif item.kind is EntryKind.EFFECT:
            if self._step is not None:
                self._step.effects.append(item)
        else:
            yield from self._ended()
            if item.kind is EntryKind.EVENT:
                self._step = Step(item)
            else:
                yield item, self._log_ns

    def _ended(self, *, is_cut: bool = False) -> Iterator[tuple[Item, LogTimes]]:
        """Yield the present step; `is_cut` where the journal may lack effects of it."""
        step, self._step = self._step, None
        if step is not None:
            step.cut = is_cut
            yield step, self._log_ns
