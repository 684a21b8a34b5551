"""The names of types as recordings of different tools hold them."""

from __future__ import annotations

import re

from mcap.records import Channel, Schema

_TWO_PARTS = re.compile(r"([a-z][a-z0-9_]*)/([A-Z][A-Za-z0-9]*)")


def type_name_of(channel: Channel, schema: Schema | None) -> str:
    """Return the type of a channel, "" where it has none.

    `pkg/T`, as some tools write for messages of ROS 2, is `pkg/msg/T`.
    """
    name = schema.name if schema else ""
    if channel.message_encoding != "cdr":
        return name
    match = _TWO_PARTS.fullmatch(name)
    return f"{match[1]}/msg/{match[2]}" if match else name
