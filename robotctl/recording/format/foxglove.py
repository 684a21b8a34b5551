"""Events as Foxglove shows them: `foxglove_msgs/msg/Event`, which no ROS package contains.

https://docs.foxglove.dev/docs/sdk/schemas/event specifies the type and its fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from robotctl.kernel.units import NS_PER_S
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode

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


_EVENT: Final = parse_definition(TYPE_NAME, DEFINITION)


def encode_event(start_ns: int, end_ns: int, metadata: Mapping[str, str]) -> bytes:
    """Return an event as ROS serializes it (CDR); times in nanoseconds since the epoch."""
    start, end = ({"sec": ns // NS_PER_S, "nanosec": ns % NS_PER_S} for ns in (start_ns, end_ns))
    pairs = [{"key": key, "value": value} for key, value in metadata.items()]
    return encode(_EVENT, {"start_time": start, "end_time": end, "metadata": pairs})
