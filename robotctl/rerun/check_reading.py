"""Reads a recording for a check: the journal as steps, and the compared topics, in their order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import chain

from robotctl.errors import UnreadableFile
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.read.journal_reader import EntryDecoder
from robotctl.recording.read.messages import Message
from robotctl.recording.read.spots import Spot
from robotctl.rerun.check_report import Report
from robotctl.rerun.journal_chain import JournalChain
from robotctl.rerun.journal_steps import Item, LogTimes, Step, steps
from robotctl.rerun.reading_position import ReadingPosition
from robotctl.rerun.recording_ends import RecordingEnds

MAX_BATCH = 512
"""How many items are read before they are looked at."""

Readers = Mapping[str, Callable[[Message], None]]
"""What takes the messages of each compared topic."""


class CheckReading:
    """One pass over a recording.

    `end_ns` is that of the last entry that was read; `chain` and `position` are up to date at the
    end of each batch.
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
        self.position = ReadingPosition()
        self.end_ns = 0
        self._row: list[bytes] = []
        """The last entries as they are recorded, if they are not noted yet."""

        self._last_seq = -2  # no entry is the next one
        self._log_ns: LogTimes = (0, 0)
        self._last_ns = 0
        self._batch: list[tuple[Item, LogTimes]] = []
        self._has_begun = False

    def batches(self, topic: str, readers: Readers) -> Iterator[list[tuple[Item, LogTimes]]]:
        """Yield the items in their order, each with the log times of what was read before it.

        A snapshot and a gap are the last items of their batch. Messages before the first snapshot
        go to their `readers` at once.

        Raises:
            UnreadableFile: After the last batch, if the journal cannot be read.
        """
        try:
            for item in steps(self._entries(topic, readers)):
                self._batch.append((item, self._log_ns))
                if not isinstance(item, Step) or len(self._batch) >= MAX_BATCH:
                    self._has_begun = self._has_begun or isinstance(item, JournalEntry)
                    yield self._taken()
        except UnreadableFile:
            yield self._taken()
            raise
        yield self._taken()

    def _taken(self) -> list[tuple[Item, LogTimes]]:
        taken, self._batch = self._batch, []
        return taken

    def _entries(self, topic: str, readers: Readers) -> Iterator[JournalEntry]:
        """Yield the journal entries; put the other messages into the batch."""
        report, row, event, effect = self._report, self._row, EntryKind.EVENT, EntryKind.EFFECT
        blocks = self._recording.blocks_in_order_written(
            {topic, *readers}, report.miss, self._on_progress, self._enter
        )
        for message in chain.from_iterable(blocks):
            if message.topic == topic:
                entry = decode(message.data)
                seq, t_ns, kind, _, _ = entry
                if seq != self._last_seq + 1 or len(row) >= MAX_BATCH:
                    self._note_row()
                    if not report.begin_log_ns:
                        self._ends.first_message(message)
                        report.begin_ns, report.begin_log_ns = t_ns, message.log_ns
                row.append(message.data)
                self._last_seq, self.end_ns, self._last_ns = seq, t_ns, message.log_ns
                if kind is not effect:
                    self._log_ns = self._log_ns[1], message.log_ns
                    if kind is not event:
                        self._decoder.count_snapshot()
                        self._note_row()
                yield entry
            elif self._has_begun:
                self._batch.append((message, self._log_ns))
            else:
                readers[message.topic](message)
        self._note_row()
        self._log_ns = self._log_ns[1], max(self._log_ns[1], self._last_ns)  # of the last step

    def _enter(self, spot: Spot) -> None:
        self._note_row()
        self.position.enter(spot)

    def _note_row(self) -> None:
        """Note the entries that were read since the last time; their numbers follow each other."""
        if self._row:
            self._decoder.count(self._row)
            last = self._last_seq
            first = last - len(self._row) + 1
            self.chain.add(first, *self._row)
            self.position.entries(first, last)
            self._ends.entries(first, last)
            self._row.clear()
