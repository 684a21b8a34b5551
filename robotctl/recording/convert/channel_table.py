"""The channels of a converted recording: the same ids in each of its files."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from mcap.records import Channel, Schema

from robotctl.errors import UnreadableFile
from robotctl.recording.convert.named_policies import named_policies
from robotctl.recording.format.topics import Topic

_MAX_CHANNELS: Final = 1 << 16
"""A channel id of MCAP has 16 bits."""

_QOS = "offered_qos_profiles"


class ChannelTable:
    """Collects the channels of all source files; equal ones become one."""

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self.schemas: list[Schema] = []
        self.topics: list[Topic] = []
        """What `metadata.yaml` says about each channel, by its id."""

        self._ids: dict[tuple[object, ...], int] = {}
        self._schema_ids: dict[tuple[object, ...], int] = {}

    def add(self, channel: Channel, schema: Schema | None) -> int:
        """Return the id that the converted recording has for a channel of a source file."""
        metadata = dict(channel.metadata)
        if _QOS in metadata:
            metadata[_QOS] = named_policies(metadata[_QOS])
        schema_id = 0 if schema is None else self._add_schema(schema)
        key = (channel.topic, channel.message_encoding, schema_id, tuple(sorted(metadata.items())))
        if key not in self._ids:
            number = self._ids[key] = len(self.channels)
            if number >= _MAX_CHANNELS:
                raise UnreadableFile(
                    f"its files have more than {_MAX_CHANNELS} topics", "convert them one by one"
                )
            self.channels.append(
                replace(channel, id=number, schema_id=schema_id, metadata=metadata)
            )
            self.topics.append(
                Topic(
                    name=channel.topic,
                    type_name="" if schema is None else schema.name,
                    type_hash=metadata.get("topic_type_hash", ""),
                    offered_qos=metadata.get(_QOS, ""),
                    encoding=channel.message_encoding,
                )
            )
        return self._ids[key]

    def _add_schema(self, schema: Schema) -> int:
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schema_ids:
            self._schema_ids[key] = len(self.schemas) + 1
            self.schemas.append(replace(schema, id=self._schema_ids[key]))
        return self._schema_ids[key]
