"""What a recording holds, according to its indexes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Metadata

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.format.records import type_name_of
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.messages import OpenFile

_QOS_KEY = "offered_qos_profiles"
_HASH_KEY = "topic_type_hash"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a recording says about a topic; `rate_hz` is the mean over the whole recording."""

    name: str
    type_name: str
    message_count: int
    rate_hz: float
    encoding: str
    offered_qos: str
    type_hash: str
    schema_encoding: str
    definition: str


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a recording holds; times in nanoseconds since the epoch, 0 without messages.

    `missing` has a sentence for each part that cannot be read. `indexed` is False if a file without
    a valid summary was scanned. `metadata` has the last record of each name.
    """

    path: Path
    files: tuple[Path, ...]
    size_bytes: int
    start_ns: int
    end_ns: int
    message_count: int
    topics: tuple[TopicInfo, ...]
    profile: str
    library: str
    metadata: dict[str, dict[str, str]]
    events: tuple[RecordedEvent, ...]
    indexed: bool
    missing: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end_ns - self.start_ns) / NS_PER_S


def describe(path: Path, files: Sequence[OpenFile], missing: Sequence[str]) -> RecordingInfo:
    """Return what these files of the recording `path` hold; there must be at least one."""
    indexes = [each.index for each in files]
    with_messages = [index for index in indexes if index.message_count]
    start_ns = min((index.start_ns for index in with_messages), default=0)
    end_ns = max((index.end_ns for index in with_messages), default=0)
    metadata = metadata_in(files)
    return RecordingInfo(
        path=path,
        files=tuple(each.path for each in files),
        size_bytes=sum(each.file.size for each in files),
        start_ns=start_ns,
        end_ns=end_ns,
        message_count=sum(index.message_count for index in indexes),
        topics=_topics(indexes, (end_ns - start_ns) / NS_PER_S),
        profile=indexes[0].profile,
        library=indexes[0].library,
        metadata={record.name: record.metadata for record in metadata},
        events=tuple(events_in(metadata)),
        indexed=not any(index.scanned for index in indexes),
        missing=tuple(missing),
    )


def metadata_in(files: Sequence[OpenFile]) -> list[Metadata]:
    """Return all metadata records, in the order of the files."""
    return [record for each in files for record in each.index.metadata]


def _topics(indexes: list[FileIndex], duration_s: float) -> tuple[TopicInfo, ...]:
    topics: dict[tuple[str, str], TopicInfo] = {}
    for index in indexes:
        definitions = {  # decoded once, since channels may share them
            schema.id: schema.data.decode(errors="replace") for schema in index.schemas.values()
        }
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            type_name = type_name_of(channel, schema)
            known = topics.get((channel.topic, type_name))
            count = index.counts.get(channel.id, 0) + (known.message_count if known else 0)
            topics[channel.topic, type_name] = TopicInfo(
                name=channel.topic,
                type_name=type_name,
                message_count=count,
                rate_hz=count / duration_s if duration_s > 0 else 0.0,
                encoding=channel.message_encoding,
                offered_qos=channel.metadata.get(_QOS_KEY, ""),
                type_hash=channel.metadata.get(_HASH_KEY, ""),
                schema_encoding=schema.encoding if schema else "",
                definition=definitions.get(channel.schema_id, ""),
            )
    return tuple(topics[key] for key in sorted(topics))
