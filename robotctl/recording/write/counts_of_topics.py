"""Copies of the counts of all topics: only what changed since the last look is copied again."""

from __future__ import annotations

from collections.abc import Sequence

from robotctl.recording.format.message_counts import COUNTERS
from robotctl.recording.format.topics import TopicStats, total
from robotctl.recording.write.channel_state import ChannelState


class CountsOfTopics:
    """Copies of the counts of channels, to which channels are only ever added."""

    def __init__(self, channels: Sequence[ChannelState], marks: bytearray) -> None:
        """`marks` are those of the channels, one byte each; a new channel is marked."""
        self._channels = channels
        self._marks = marks
        self.topics: tuple[TopicStats, ...] = ()
        """The counts of each channel; those that do not change stay the same object."""

        self.sums = dict.fromkeys(COUNTERS, 0)
        """The sum of each counter, by name."""

    def update(self) -> None:
        """Copy what has changed. Call it in the loop's thread."""
        channels, marks = self._channels, self._marks
        place = marks.find(1)
        if place < 0:
            return
        counts, gone, come = list(self.topics), list[TopicStats](), list[TopicStats]()
        counts += [TopicStats()] * (len(channels) - len(counts))
        try:
            while place >= 0:
                marks[place] = 0  # first: a change that the copy lacks marks it again
                gone.append(counts[place])
                counts[place] = new = channels[place].stats()
                come.append(new)
                place = marks.find(1, place + 1)
            before, after = total(gone), total(come)
            sums = {name: self.sums[name] - before[name] + after[name] for name in COUNTERS}
            self.topics, self.sums = tuple(counts), sums
        except MemoryError:
            for state in channels:
                state.mark()
            raise
