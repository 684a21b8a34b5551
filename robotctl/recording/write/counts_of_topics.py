"""Copies of the counts of all topics: only what changed since the last question is copied again."""

from __future__ import annotations

from collections.abc import Sequence

from robotctl.recording.format.topics import TopicStats
from robotctl.recording.write.channel_state import ChannelState


class CountsOfTopics:
    """Copies of the counts of channels, to which channels are only ever added."""

    def __init__(self, channels: Sequence[ChannelState]) -> None:
        self._channels = channels
        self._counts: tuple[TopicStats, ...] = ()

    def now(self) -> tuple[TopicStats, ...]:
        """Return the counts of each channel; what did not change is the same object as before.

        Call it in the loop's thread.
        """
        channels, known = self._channels, len(self._counts)
        changed = [
            place
            for place, state in enumerate(channels[:known])
            if state.recounted or state.received + state.throttled != state.told
        ]
        if changed or len(channels) > known:
            counts = [*self._counts, *[state.stats() for state in channels[known:]]]
            for place in changed:
                counts[place] = channels[place].stats()
            self._counts = tuple(counts)
        return self._counts
