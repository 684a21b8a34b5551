"""The rows of `status`, one for each topic and type; one that has not changed is encoded once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from robotctl.daemon.recording.topic_rates import TopicKey
from robotctl.recording.format.topics import TopicStats, by_topic

_encode = msgspec.json.Encoder().encode


class _Answer(msgspec.Struct):
    """A TopicAnswer, which is made and encoded in 0.6 of the time of its dictionary."""

    name: str
    type: str
    count: int
    rate: float
    bytes: int
    written: int
    queued: int
    dropped: int
    lost: int
    throttled: int
    unseen: int


@dataclass(slots=True, eq=False)
class _Row:
    key: TopicKey
    at: int
    """Where the row stands in the answer."""

    places: list[int] = field(default_factory=list)
    """Where the channels of the topic stand in the recorder's counts."""

    rate: float = 0.0


class TopicRows:
    """The rows, sorted by name and type. The recorder only ever adds channels."""

    def __init__(self) -> None:
        self._rows: list[_Row] = []
        self._row_of: list[_Row] = []
        """By the place of a channel."""

        self._topics: Sequence[TopicStats] = ()
        self._rates: Mapping[TopicKey, float] = {}
        self._encoded: list[bytes] = []
        self._joined = msgspec.Raw(b"[]")

    def encoded(self, topics: Sequence[TopicStats], rates: Mapping[TopicKey, float]) -> msgspec.Raw:
        """Return the list of rows in JSON; counts that did not change are the objects of before.

        A topic that is missing in `rates` has a rate of 0.
        """
        if topics is self._topics and rates is self._rates:
            return self._joined
        before = self._topics
        if len(topics) != len(before):
            self._arrange(topics)
            changed = dict.fromkeys(self._rows)
        else:
            rows = zip(self._row_of, before, topics, strict=True)
            changed = dict.fromkeys([row for row, old, new in rows if old is not new])
        if rates is not self._rates:
            changed |= dict.fromkeys(self._take_rates(rates))
        if changed:
            encoded = self._encoded
            for row in changed:
                places = row.places
                stats = topics[places[0]] if len(places) == 1 else _sum(topics, places)
                encoded[row.at] = _encode(_answer(stats, row.rate))
            self._joined = msgspec.Raw(b"[" + b",".join(encoded) + b"]")
        self._topics = topics
        return self._joined

    def _arrange(self, topics: Sequence[TopicStats]) -> None:
        keys = [(topic.name, topic.type_name) for topic in topics]
        rows = {key: _Row(key, at) for at, key in enumerate(sorted(set(keys)))}
        for place, key in enumerate(keys):
            rows[key].places.append(place)
        self._rows, self._row_of = list(rows.values()), [rows[key] for key in keys]
        self._encoded = [b""] * len(rows)
        self._rates = {}

    def _take_rates(self, rates: Mapping[TopicKey, float]) -> list[_Row]:
        """Return the rows whose rate has changed."""
        self._rates = rates
        changed = [row for row in self._rows if row.rate != rates.get(row.key, 0.0)]
        for row in changed:
            row.rate = rates.get(row.key, 0.0)
        return changed


def _sum(topics: Sequence[TopicStats], places: Sequence[int]) -> TopicStats:
    return by_topic(topics[place] for place in places)[0]


def _answer(topic: TopicStats, rate: float) -> _Answer:
    return _Answer(
        topic.name,
        topic.type_name,
        topic.received,
        rate,
        topic.bytes,
        topic.written,
        topic.queued,
        topic.dropped,
        topic.lost,
        topic.throttled,
        topic.unseen,
    )
