"""Edits recordings, and writes valid files again: with CRCs, indexes and a ledger that agree."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema

from robotctl.config import Config
from robotctl.recording.format.disk import new_file
from robotctl.recording.format.names import LEDGER_RECORD, Compression
from robotctl.recording.format.rosbag2 import METADATA_RECORD, BagFile, serialized_metadata
from robotctl.recording.format.topics import Topic
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import FileSeal, McapFile, Sealer
from robotctl.testing.drives import Written, record

CHUNK = 200
"""The number of messages in a chunk."""


@dataclass(frozen=True, order=True, slots=True)
class Stored:
    """A message of a recording."""

    topic: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(slots=True)
class Contents:
    """The contents of a file: messages and metadata records, both in file order."""

    library: str
    types: list[tuple[Channel, Schema]]
    messages: list[Stored]
    metadata: list[tuple[str, dict[str, str]]]
    counts: Counter[str] = field(init=False)

    def __post_init__(self) -> None:
        """Remember how many messages each topic had."""
        self.counts = Counter(each.topic for each in self.messages)

    def lose(self, topic: str, count: int) -> None:
        """Add `count` to the lost messages of a topic in the ledger."""
        for name, values in self.metadata:
            if name == LEDGER_RECORD:
                counts = json.loads(values[topic])
                values[topic] = json.dumps({**counts, "lost": counts["lost"] + count})

    def unclosed(self) -> Contents:
        """Return a copy without a ledger, as in a recording that was not closed."""
        edited = self.copy()
        edited.metadata = [each for each in edited.metadata if each[0] != LEDGER_RECORD]
        return edited

    def without(self, topic: str) -> Contents:
        """Return a copy without a topic, its messages and its channel."""
        edited = edit(self, topic, lambda at, each: None)
        edited.types = [each for each in edited.types if each[0].topic != topic]
        return edited

    def snapshots(self) -> list[int]:
        """Return the positions of the snapshots among the messages."""
        return [at for at, each in enumerate(self.messages) if b"Snapshot" in each.data[:60]]

    def copy(self) -> Contents:
        """Return a copy that can be edited; both share the messages, which are immutable."""
        metadata = [(name, dict(values)) for name, values in self.metadata]
        copied = replace(self, messages=list(self.messages), metadata=metadata)
        copied.counts = self.counts
        return copied


def stored(channel: Channel, message: Message) -> Stored:
    """Return a message that the mcap package has read."""
    return Stored(
        channel.topic, message.data, message.log_time, message.publish_time, message.sequence
    )


def contents_of(path: Path) -> Contents:
    """Return the contents of a file."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        library = reader.get_header().library
        summary = reader.get_summary()
        assert summary is not None
        types = [(each, summary.schemas[each.schema_id]) for each in summary.channels.values()]
        found = reader.iter_messages(log_time_order=False)
        messages = [stored(channel, message) for _, channel, message in found]
        metadata = [(each.name, each.metadata) for each in reader.iter_metadata()]
    return Contents(library, types, messages, metadata)


def write_contents(folder: Path, contents: Contents, sealer: Sealer | None = None) -> Path:
    """Write a recording of one file into a new folder, and return the folder."""
    folder.mkdir(parents=True)
    found = Counter(each.topic for each in contents.messages)
    target = folder / f"{folder.name}_0.mcap"
    with new_file(target) as storage:
        seal = None if sealer is None else FileSeal(sealer)
        mcap = McapFile(storage, profile="ros2", library=contents.library, seal=seal)
        if seal is not None:
            mcap.add_sealed(seal.open(target.name))
        ledger = None
        for name, values in contents.metadata:
            if name == LEDGER_RECORD:
                ledger = _adjusted(values, contents.counts, found)
            elif name != METADATA_RECORD:
                mcap.add_metadata(name, values)
        topics = [_add_topic(mcap, number, *each) for number, each in enumerate(contents.types)]
        numbers = {topic.name: number for number, topic in enumerate(topics)}
        encoder = ChunkEncoder(Compression.ZSTD, 1)
        for at in range(0, len(contents.messages), CHUNK):
            chunk = [
                (numbers[each.topic], each.data, each.log_ns, each.publish_ns, each.sequence)
                for each in contents.messages[at : at + CHUNK]
            ]
            mcap.commit(encoder.encode(pack(chunk)), finished=False)
        summary = mcap.summary
        file = BagFile(target.name, summary.start_ns, summary.end_ns, dict(summary.counts))
        text = serialized_metadata(topics, [file])
        mcap.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
        if ledger is not None:
            mcap.add_metadata(LEDGER_RECORD, ledger)
        mcap.commit()
    return folder


def _add_topic(mcap: McapFile, number: int, channel: Channel, schema: Schema) -> Topic:
    mcap.add_schema(replace(schema, id=number + 1))
    mcap.add_channel(replace(channel, id=number, schema_id=number + 1))
    return Topic(
        channel.topic,
        schema.name,
        type_hash=channel.metadata.get("topic_type_hash", ""),
        offered_qos=channel.metadata.get("offered_qos_profiles", ""),
    )


def _adjusted(ledger: dict[str, str], before: Counter[str], found: Counter[str]) -> dict[str, str]:
    """Return the ledger with the counts of the messages that are written now."""
    adjusted = {}
    for topic, text in ledger.items():
        counts, more = json.loads(text), found[topic] - before[topic]
        counts["received"] += more
        counts["written"] += more
        adjusted[topic] = json.dumps(counts)
    return adjusted


def recorded(written: Iterable[Written], config: Config | None = None) -> Contents:
    """Record `written`, and return the contents of the file."""
    with TemporaryDirectory() as folder:
        (file,) = record(Path(folder, "run"), written, config=config).glob("*.mcap")
        return contents_of(file)


def edit(
    contents: Contents, topic: str, change: Callable[[int, Stored], Stored | None]
) -> Contents:
    """Return the contents with each message of a topic replaced by what `change` returns.

    `change` gets the position of the message in its topic, and the message; None removes it.
    """
    edited, position = contents.copy(), -1
    edited.messages = []
    for each in contents.messages:
        kept: Stored | None = each
        if each.topic == topic:
            position += 1
            kept = change(position, each)
        if kept is not None:
            edited.messages.append(kept)
    return edited
