"""Reads a recording for a check: the journal as steps, and the compared topics, in their order."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from itertools import chain

from robotctl.errors import UnreadableFile
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.read.journal_reader import EntryDecoder
from robotctl.recording.read.messages import Message
from robotctl.recording.read.topic_places import Spot
from robotctl.rerun.batch import Batch, End
from robotctl.rerun.check_report import Report
from robotctl.rerun.entry_order import EntryOrder, Gap
from robotctl.rerun.journal_chain import JournalChain
from robotctl.rerun.journal_steps import LogTimes, Step
from robotctl.rerun.log_order import LogOrder
from robotctl.rerun.reading_position import ReadingPosition
from robotctl.rerun.recording_ends import RecordingEnds

MAX_BATCH = 512
"""How many items are read before they are looked at."""

Readers = Mapping[str, Callable[[Message], None]]
"""What takes the messages of each compared topic."""

_NONE = -1
"""The number of no entry."""

_EVENT, _EFFECT, _SNAPSHOT = EntryKind
"""What each entry is compared with; Python 3.11 takes six times as long for a member of an enum."""


class CheckReading:
    """One pass over a recording.

    `end_ns` is that of the last entry that was read; `chain` and `position` are up to date at the
    end of each batch that a snapshot ends.
    """

    def __init__(
        self,
        recording: Recording,
        report: Report,
        ends: RecordingEnds,
        on_progress: Callable[[int, int], None],
        on_place: Callable[[Spot], None],
    ) -> None:
        """Read a recording; `on_place` gets each place before it is read."""
        self._recording = recording
        self._report = report
        self._ends = ends
        self._on_progress = on_progress
        self._on_place = on_place
        self._decoder = EntryDecoder(recording)
        self.chain = JournalChain()
        self.position = ReadingPosition()
        self.log_order = LogOrder()
        self.end_ns = 0
        self._row: list[bytes] = []
        """The last entries as they are recorded, if they are not noted yet."""

        self._last_seq = -2  # no entry is the next one
        self._order = EntryOrder()
        self._following = _NONE
        """The number of an entry that follows the last one, and is the next of the journal."""

        self._log_ns: LogTimes = (0, 0)
        self._last_ns = 0
        self._batch = Batch()
        self._step: Step | None = None
        """The last step, of which effects may follow."""

        self._has_begun = False

    def batches(self, topic: str, readers: Readers, ordinary: Container[str]) -> Iterator[Batch]:
        """Yield what is read in its order; each step has the log times of what was read before it.

        A snapshot, a gap and a message of a topic that is not `ordinary` end their batch. Messages
        before the first snapshot go to their `readers` at once.

        Raises:
            UnreadableFile: After the last batch, if the journal cannot be read.
        """
        try:
            yield from self._full_batches(topic, readers, ordinary)
        except UnreadableFile:
            yield self._batch
            raise
        yield self._batch

    def _full_batches(
        self, topic: str, readers: Readers, ordinary: Container[str]
    ) -> Iterator[Batch]:
        row = self._row
        blocks = self._recording.blocks_in_order_written(
            {topic, *readers}, self._report.miss, self._on_progress, self._enter
        )
        for message in chain.from_iterable(self._ends.origin.watch(self._timed(blocks))):
            name, _, data, log_ns, _, _ = message
            if name != topic:
                if not self._has_begun:
                    readers[name](message)
                elif name in ordinary:
                    self._batch.add_message(message)
                else:
                    yield self._ended(message)
                continue
            entry = decode(data)
            seq, self.end_ns, kind, _, _ = entry
            is_next = seq == self._following and len(row) < MAX_BATCH
            if not is_next:
                self._begin_row(message, entry)
            row.append(data)
            self._last_seq, self._last_ns = seq, log_ns
            if kind is not _EFFECT:
                self._log_ns = self._log_ns[1], log_ns
                if kind is _SNAPSHOT:
                    self._decoder.count_snapshot()
                    self._note_row()
            if is_next:
                self._following = self._order.following = seq + 1
                if kind is _EFFECT:
                    if self._step is not None:
                        self._step.effects.append(entry)
                elif (batch := self._take(entry)) is not None:
                    yield batch
            else:
                for item in self._order.take(entry):
                    if (batch := self._take(item)) is not None:
                        yield batch
                self._find_following()
        self._note_row()
        self._log_ns = self._log_ns[1], max(self._log_ns[1], self._last_ns)  # of the last step
        for item in self._order.rest():
            if (batch := self._take(item)) is not None:
                yield batch
        self._cut_step()

    def _timed(self, blocks: Iterable[list[Message]]) -> Iterator[list[Message]]:
        for block in blocks:
            self.log_order.take(block)
            yield block

    def _take(self, item: JournalEntry | Gap) -> Batch | None:
        """Take the next item of the journal; return the batch that ends with it, if one does."""
        if type(item) is Gap:
            self._cut_step()
            return self._ended(item)
        if item.kind is _EVENT:
            self._end_step()
            self._step = Step(item, [])
            return self._ended(None) if len(self._batch.items) >= MAX_BATCH else None
        if item.kind is _SNAPSHOT:
            self._end_step()
            self._has_begun = True
            return self._ended(item)
        if self._step is not None:
            self._step.effects.append(item)
        return None

    def _end_step(self) -> None:
        step = self._step
        if step is not None:
            self._step = None
            self._batch.add(step, self._log_ns)

    def _cut_step(self) -> None:
        """End the last step where the journal does."""
        if self._step is not None:
            self._step.cut = True
            self._end_step()

    def _ended(self, end: End | None) -> Batch:
        """Begin another batch, and return the present one."""
        batch, self._batch = self._batch, Batch()
        batch.end, batch.end_log_times = end, self._log_ns
        return batch

    def _begin_row(self, message: Message, entry: JournalEntry) -> None:
        """Note the row before an entry that does not follow it, and one that is long enough."""
        if entry.seq == self._last_seq + 1 and len(self._row) < MAX_BATCH:
            return
        self._note_row()
        if not self._report.begin_log_ns:
            self._ends.origin.first(message)
            self._report.begin_ns, self._report.begin_log_ns = entry.t_ns, message.log_ns

    def _find_following(self) -> None:
        following = self._last_seq + 1
        is_next = following == self._order.following and not self._order.is_waiting
        self._following = following if is_next else _NONE

    def _enter(self, spot: Spot) -> None:
        self._note_row()
        self.position.enter(spot)
        self._on_place(spot)

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
