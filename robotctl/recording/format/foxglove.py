"""Events as Foxglove shows them: `foxglove_msgs/msg/Event`, which no ROS package contains.

https://docs.foxglove.dev/docs/sdk/schemas/event specifies the type and its fields.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

from robotctl.kernel.units import NS_PER_S
from robotctl.messages.cdr import ENCAPSULATION

TOPIC: Final = "robotctl/events"
TYPE_NAME: Final = "foxglove_msgs/msg/Event"

_LINE: Final = "=" * 80

DEFINITION: Final = f"""\
# Something that happened, from its beginning to its end
builtin_interfaces/Time start_time
builtin_interfaces/Time end_time
# What it was; each key stands once
foxglove_msgs/KeyValuePair[] metadata
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: foxglove_msgs/KeyValuePair
string key
string value
"""

_TIME: Final = struct.Struct("<iI")
_LENGTH: Final = struct.Struct("<I")


def encode_event(start_ns: int, end_ns: int, metadata: Mapping[str, str]) -> bytes:
    """Return an event as ROS serializes it (CDR); times in nanoseconds since the epoch."""
    content = bytearray()
    for time_ns in (start_ns, end_ns):
        content += _TIME.pack(*divmod(time_ns, NS_PER_S))
    content += _LENGTH.pack(len(metadata))
    for pair in metadata.items():
        for text in pair:
            data = text.encode(errors="backslashreplace") + b"\0"
            content += b"\0" * (-len(content) % _LENGTH.size) + _LENGTH.pack(len(data)) + data
    return ENCAPSULATION + bytes(content)
