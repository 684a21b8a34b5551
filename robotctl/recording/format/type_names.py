"""The names of types, as recordings of different tools store them."""

from __future__ import annotations

import re

from mcap.records import Channel, Schema

_TWO_PARTS = re.compile(r"([a-z][a-z0-9_]*)/([A-Z][A-Za-z0-9]*)")


def type_name_of(channel: Channel, schema: Schema | None) -> str:
    """Return the type of a channel, "" if it has none.

    `pkg/T`, which some tools write for ROS 2 messages, becomes `pkg/msg/T`.
    """
    name = schema.name if schema else ""
    if channel.message_encoding != "cdr":
        return name
    match = _TWO_PARTS.fullmatch(name)
    return f"{match[1]}/msg/{match[2]}" if match else name
