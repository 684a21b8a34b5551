"""The rows of `status`, one for each topic and type; one that has not changed is encoded once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from robotctl.daemon.recording.topic_rates import TopicKey
from robotctl.ipc.answers import TopicAnswer
from robotctl.recording.format.topics import TopicStats, by_topic

_encode = msgspec.json.Encoder().encode


@dataclass(slots=True)
class _Row:
    places: list[int]
    """Where the channels of the topic stand in the recorder's counts."""

    stats: TopicStats | None = None
    """The counts that are encoded, None if the row is to be encoded again."""

    rate: float = 0.0
    encoded: msgspec.Raw = field(default_factory=msgspec.Raw)


class TopicRows:
    """The rows, sorted by name and type. The recorder only ever adds channels."""

    def __init__(self) -> None:
        self._rows: list[_Row] = []
        self._channels = 0
        self._rates: Mapping[TopicKey, float] = {}

    def encoded(
        self, topics: Sequence[TopicStats], rates: Mapping[TopicKey, float]
    ) -> list[msgspec.Raw]:
        """Return each row in JSON; counts that did not change are the same objects as before.

        A topic that is missing in `rates` has a rate of 0.
        """
        if len(topics) != self._channels:
            self._arrange(topics)
        if rates is not self._rates:
            self._take_rates(topics, rates)
        for row in self._rows:
            places = row.places
            stats = topics[places[0]] if len(places) == 1 else _sum(topics, places)
            if stats is not row.stats:
                row.stats = stats
                row.encoded = msgspec.Raw(_encode(_answer(stats, row.rate)))
        return [row.encoded for row in self._rows]

    def _arrange(self, topics: Sequence[TopicStats]) -> None:
        places: dict[TopicKey, list[int]] = {}
        for place, topic in enumerate(topics):
            places.setdefault((topic.name, topic.type_name), []).append(place)
        self._rows = [_Row(places[key]) for key in sorted(places)]
        self._channels, self._rates = len(topics), {}

    def _take_rates(self, topics: Sequence[TopicStats], rates: Mapping[TopicKey, float]) -> None:
        for row in self._rows:
            topic = topics[row.places[0]]
            rate = rates.get((topic.name, topic.type_name), 0.0)
            if rate != row.rate:
                row.rate, row.stats = rate, None
        self._rates = rates


def _sum(topics: Sequence[TopicStats], places: Sequence[int]) -> TopicStats:
    return by_topic(topics[place] for place in places)[0]


def _answer(topic: TopicStats, rate: float) -> TopicAnswer:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "count": topic.received,
        "rate": rate,
        "bytes": topic.bytes,
        "written": topic.written,
        "queued": topic.queued,
        "dropped": topic.dropped,
        "lost": topic.lost,
        "throttled": topic.throttled,
        "unseen": topic.unseen,
    }
