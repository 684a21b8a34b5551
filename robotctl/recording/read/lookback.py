"""Finds the last messages before a moment by a backward search through the index."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.messages import Message, OpenFile, PlaceReader, place_readers

_Placed = tuple[int, int, int, Message]
"""Log time, rank of the place, number in it (the order of `merge`), and the message."""


def last_before(
    files: Sequence[OpenFile],
    wanted: Mapping[str, int],
    moment_ns: int,
    on_missing: Callable[[str], None],
) -> list[Message]:
    """Return the last messages before `moment_ns` in order, as many of each topic as `wanted` says.

    Only places that may hold them are read. `on_missing` gets a sentence about each lost part.
    """
    found = list(enumerate(place_readers(files, wanted, (0, moment_ns - 1))))
    found.sort(key=lambda ranked: ranked[1].place.end_ns, reverse=True)
    held: dict[str, list[_Placed]] = {topic: [] for topic in wanted}
    for rank, source in found:
        end_ns = source.place.end_ns
        unsettled = {
            topic
            for topic, count in wanted.items()
            if len(held[topic]) < count or held[topic][0][0] <= end_ns
        }
        if not unsettled:
            break
        if source.may_hold(unsettled):
            placed: dict[str, list[_Placed]] = {topic: [] for topic in unsettled}
            for number, message in enumerate(_messages(source, on_missing)):
                if message.topic in placed:
                    placed[message.topic].append((message.log_ns, rank, number, message))
            for topic, mine in placed.items():
                held[topic] = sorted(mine + held[topic])[-wanted[topic] :]
    return [each[-1] for each in sorted(each for topic in held.values() for each in topic)]


def _messages(source: PlaceReader, on_missing: Callable[[str], None]) -> list[Message]:
    try:
        source.load()
    except Damaged as damage:
        on_missing(source.loss(damage))
    messages = []
    while source.next < len(source.entries):
        try:
            messages.append(source.take())
        except Damaged as damage:
            on_missing(source.loss(damage))
    source.unload()
    return messages
