"""Rewrites a folder's `metadata.yaml` from what its files say."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from robotctl.recording.format.rosbag2 import BagFile, write_metadata
from robotctl.recording.format.topics import Topic
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.mcap_input import InputFile


def rewrite_metadata(folder: Path, files: Sequence[Path]) -> None:
    """Write the `metadata.yaml` of `folder` with `files`, in this order, as far as they can be
    read.

    Raises:
        OSError: It cannot be written.
    """
    topics: dict[Topic, int] = {}
    described = []
    for path in files:
        with suppress(Damaged), InputFile(path) as file:
            described.append(_describe(path.name, index_of(file), topics))
    write_metadata(folder, topics, described)


def _describe(name: str, index: FileIndex, topics: dict[Topic, int]) -> BagFile:
    counts: dict[int, int] = {}
    for channel in index.channels.values():
        schema = index.schemas.get(channel.schema_id)
        topic = Topic(
            name=channel.topic,
            type_name=schema.name if schema else "",
            type_hash=channel.metadata.get("topic_type_hash", ""),
            offered_qos=channel.metadata.get("offered_qos_profiles", ""),
            encoding=channel.message_encoding,
        )
        position = topics.setdefault(topic, len(topics))
        counts[position] = counts.get(position, 0) + index.counts.get(channel.id, 0)
    return BagFile(name, index.start_ns, index.end_ns, counts)
