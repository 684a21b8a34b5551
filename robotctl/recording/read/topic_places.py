"""The places of a recording that hold a topic, numbered so that another process finds them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.messages import ALWAYS, Message, OpenFile, place_readers


class Spot(NamedTuple):
    """A place: the number of its file in the recording, and its offset [bytes]."""

    file: int
    offset: int


def spots_of(files: Sequence[OpenFile], topic: str) -> list[tuple[Spot, int]]:
    """Return the places that may hold messages of a topic, each with its bytes, in file order."""
    return [
        (Spot(number, reader.place.offset), reader.place.unpacked_bytes or reader.place.length)
        for number, file in enumerate(files)
        for reader in place_readers([file], {topic}, ALWAYS)
    ]


def messages_from(
    files: Sequence[OpenFile], topic: str, begin: Spot, is_wanted: Callable[[bytes], bool]
) -> Iterator[tuple[Spot, list[Message] | None]]:
    """Yield the messages of a topic in file order, from a place on: many at once, and their place.

    None stands for what cannot be read. A place is passed over, and yields no messages, unless
    `is_wanted(records)`.
    """
    for number, file in enumerate(files):
        for reader in place_readers([file], {topic}, ALWAYS):
            spot = Spot(number, reader.place.offset)
            if spot < begin:
                continue
            try:
                yield spot, []
                for messages in reader.as_written(is_wanted):
                    yield spot, messages
            except Damaged:
                yield spot, None
