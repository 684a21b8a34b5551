"""Compare messages, types, channels and metadata of a clip with its source recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Final

from mcap.records import Channel, Schema

from robotctl.base.errors import UnreadableFile
from robotctl.recording.format.names import CLIP_RECORD, CONVERSION_RECORD, LIBRARY, RECOVERY_RECORD
from robotctl.recording.format.recorded_events import events_in
from robotctl.recording.format.records import type_name_of
from robotctl.recording.format.rosbag2 import (
    METADATA_RECORD,
    BagFile,
    files_in,
    serialized_metadata,
)
from robotctl.recording.keep.clip import clip_messages, records_of_clip
from robotctl.recording.read.file_index import topic_of
from robotctl.recording.read.messages import Message, OpenFile
from robotctl.recording.read.reader import Recording

NOT_PROVED: Final = (
    "who cut the clip, when, and with which version",
    "what the clip says could not be read when it was cut",
)

_OWN: Final = (CLIP_RECORD, METADATA_RECORD)
"""Metadata that a clip does not copy from its source."""

_AFTERWARDS: Final = (CONVERSION_RECORD, RECOVERY_RECORD)
"""Metadata that a later conversion or repair of the clip adds."""


@dataclass(slots=True)
class Origin:
    """The result of `compare_with_source`. `messages` counts the equal messages."""

    clip: Path
    source: Path
    start_ns: int
    end_ns: int
    messages: int = 0
    wrong: list[str] = field(default_factory=list)
    not_proved: list[str] = field(default_factory=lambda: list(NOT_PROVED))


def compare_with_source(clip: Path, source: Path) -> Origin:
    """Compare the content of `clip` with `source`, a recording or one of its files.

    Raises:
        UnreadableFile: `clip` or `source` cannot be read, or `clip` is not a clip.
    """
    with Recording(clip) as cut, Recording(source) as whole:
        about = cut.info().metadata.get(CLIP_RECORD, {})
        try:
            origin = Origin(clip, source, int(about["start_ns"]), int(about["end_ns"]))
        except (KeyError, ValueError):
            raise UnreadableFile(
                f"{clip} is no clip: it does not say what it was cut from"
            ) from None
        if missing := set(about.get("of", "").split(", ")) - {p.name for p in whole.info().files}:
            origin.wrong.append(f"it was cut from {', '.join(sorted(missing))}, which is not there")
            return origin
        origin.wrong += dict.fromkeys(_differences(cut, whole, about, origin))
        theirs = clip_messages(whole, (origin.start_ns, origin.end_ns), origin.wrong.append)
        ours = cut.in_order_written(None, origin.wrong.append)
        for mine, other in zip_longest(ours, theirs):
            if mine != other:
                origin.wrong.append(_difference(mine, other))
                return origin
            origin.messages += 1
    return origin


def _differences(
    clip: Recording, source: Recording, about: Mapping[str, str], origin: Origin
) -> Iterator[str]:
    """Yield each difference, except in messages, between `clip` and the source files it names."""
    named = about.get("of", "").split(", ")
    files = [each for each in source.open_files if each.path.name in named]
    if [each.path.name for each in files] != named:
        yield "it names the files that it was cut from in another order"
    if clip.info().profile != source.info().profile:
        yield "its profile is not that of its source"
    recorded = [record for each in files for record in each.index.metadata]
    found = [(each.name, each.metadata) for each in clip.metadata()]
    if [name for name, _ in found].count(CLIP_RECORD) > 1:
        yield "it says more than once what it was cut from"
    yield from _differing_records(
        [each for each in found if each[0] not in _OWN],
        list(records_of_clip(recorded, (origin.start_ns, origin.end_ns))),
        origin,
    )
    kind, log_ns, text = (about.get(key, "") for key in ("event", "event_ns", "text"))
    told = {(each.kind.value, str(each.log_ns), each.text) for each in events_in(recorded)}
    if not kind:
        origin.not_proved.append("what the clip was cut for")
    elif (kind, log_ns, text) not in told:
        yield "the event that it was cut for is not one of its source"
    yield from _differing_channels(clip, files)
    if clip.info().library == LIBRARY and not any(name in _AFTERWARDS for name, _ in found):
        if [values for name, values in found if name == METADATA_RECORD] != [_bag_record(clip)]:
            yield "its rosbag2 record is not what its messages and channels make"
    else:
        origin.not_proved.append("its rosbag2 record, except the counts")


def _differing_records(
    mine: Sequence[tuple[str, Mapping[str, str]]],
    theirs: Sequence[tuple[str, Mapping[str, str]]],
    origin: Origin,
) -> Iterator[str]:
    left = Counter(map(_comparable, theirs))
    for record in map(_comparable, mine):
        if left[record]:
            left[record] -= 1
        elif record[0] in _AFTERWARDS:
            origin.not_proved.append(
                f"what {record[0]} says: it was written after the clip was cut"
            )
        else:
            yield f"its metadata record {record[0]} is not one of its source"
    for name, _ in left.elements():
        yield f"a metadata record {name} of its source is missing"


def _comparable(record: tuple[str, Mapping[str, str]]) -> tuple[str, frozenset[tuple[str, str]]]:
    return record[0], frozenset(record[1].items())


def _differing_channels(clip: Recording, files: Iterable[OpenFile]) -> Iterator[str]:
    theirs: dict[tuple[str, str], list[tuple[Channel, Schema | None]]] = {}
    for file in files:
        for channel in file.index.channels.values():
            schema = file.index.schemas.get(channel.schema_id)
            key = channel.topic, type_name_of(channel, schema)
            theirs.setdefault(key, []).append((channel, schema))
    for key, (channel, schema) in clip.channels().items():
        known = theirs.get(key, [])
        if not known:
            yield f"its source has no {key[0]} of type {key[1]}"
        elif not any(_same_schema(schema, other) for _, other in known):
            yield f"the definition of the type of {key[0]} is not that of its source"
        elif (channel.message_encoding, channel.metadata) not in [
            (other.message_encoding, other.metadata) for other, _ in known
        ]:
            yield f"the channel of {key[0]} is not that of its source"


def _same_schema(mine: Schema | None, other: Schema | None) -> bool:
    if mine is None or other is None:
        return mine is other
    return (mine.name, mine.encoding, mine.data) == (other.name, other.encoding, other.data)


def _bag_record(clip: Recording) -> Mapping[str, str]:
    """Return the rosbag2 record for a clip with these messages and channels."""
    found = clip.metadata_of_file(0).get(METADATA_RECORD, {}).get("serialized_metadata", "")
    index = clip.open_files[0].index
    numbers = sorted(index.channels)
    channels = clip.channels().items()
    topics = [topic_of(channel, type_name) for (_, type_name), (channel, _) in channels]
    counts = {at: index.counts[n] for at, n in enumerate(numbers) if n in index.counts}
    files = [BagFile(name, index.start_ns, index.end_ns, counts) for name in files_in(found)]
    return {"serialized_metadata": serialized_metadata(topics, files)}


def _difference(mine: Message | None, other: Message | None) -> str:
    if mine is None:
        assert other is not None
        return f"it lacks message {other.sequence} of {other.topic}"
    if other is None:
        return f"message {mine.sequence} of {mine.topic} is not in its source"
    return f"message {mine.sequence} of {mine.topic} is not the one of its source"
