"""Edits of schemas and channels: by them others read the messages that a check reads by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from random import Random

from mcap.records import Channel, Schema

from robotctl.cdr.definition import parse_definition
from robotctl.cdr.type_hash import rihs01_hash
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents
from tests.support.heard_drives import COMMANDS, ESTOP, JOURNAL, SET_MODE, STATUS
from tests.tampering.edits import Kind

Described = tuple[Channel, Schema]

READ = (COMMANDS, ODOMETRY, BATTERY, STATUS, JOURNAL, SET_MODE, ESTOP)
"""The topics whose messages a check reads."""


def described(change: Callable[[Channel, Schema], Described], *topics: str) -> Kind:
    """Change what the file tells of one of these topics."""

    def make(contents: Contents, random: Random) -> Contents:
        chosen = random.choice(topics)
        edited = contents.copy()
        edited.types = [
            change(channel, schema) if channel.topic == chosen else (channel, schema)
            for channel, schema in contents.types
        ]
        return edited

    return make


def exchanged(one: str, other: str) -> Callable[[Channel, Schema], Described]:
    """Exchange two names in the text of a type."""

    def change(channel: Channel, schema: Schema) -> Described:
        text = schema.data.decode()
        assert one in text
        text = text.replace(one, "\0").replace(other, one).replace("\0", other)
        return channel, replace(schema, data=text.encode())

    return change


def told(key: str, value: str) -> Callable[[Channel, Schema], Described]:
    """Change the metadata of a channel."""
    return lambda channel, schema: (
        replace(channel, metadata={**channel.metadata, key: value}),
        schema,
    )


def of_another_version(channel: Channel, schema: Schema) -> Described:
    """Add a field to a type, with the hash that it then has."""
    text = b"uint8 another\n" + schema.data
    type_hash = rihs01_hash(schema.name, parse_definition(schema.name, text.decode()))
    return told("topic_type_hash", type_hash)(channel, replace(schema, data=text))


def commented(channel: Channel, schema: Schema) -> Described:
    """Change the comments of a type."""
    return channel, replace(schema, data=b"# in furlongs per fortnight\n" + schema.data)


IN_SCHEMAS: Mapping[str, Kind] = {
    "schema: of another version, with its hash": described(of_another_version, *READ),
    "channel: another type hash": described(told("topic_type_hash", f"RIHS01_{0:064}"), *READ),
    "channel: no type hash": described(told("topic_type_hash", ""), *READ),
    "channel: another encoding": described(
        lambda channel, schema: (replace(channel, message_encoding="json"), schema),
        *(COMMANDS, ODOMETRY, BATTERY, STATUS),
    ),
}
"""Edits that a check finds."""

FORGED_SCHEMAS: Mapping[str, Kind] = {
    "schema: linear and angular exchanged": described(exchanged(" linear", " angular"), COMMANDS),
    "schema: x and y exchanged": described(exchanged("float64 x\n", "float64 y\n"), ODOMETRY),
    "schema: another type of a field": described(exchanged("float64", "int64"), ODOMETRY),
    "schema: its text removed": described(
        lambda channel, schema: (channel, replace(schema, data=b"")), *READ
    ),
    "schema: another encoding": described(
        lambda channel, schema: (channel, replace(schema, encoding="jsonschema")), *READ
    ),
    "channel: no quality of service": described(told("offered_qos_profiles", ""), STATUS, JOURNAL),
}
"""Edits that only the seal shows."""
