"""Reads the events of the services that request a mode, as ROS publishes them.

An event (service_msgs/ServiceEventInfo, then request and response) is a call that a server received
or a response that it sent; clients may publish theirs on the same topic.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from robotctl.cdr.reader import CdrReader
from robotctl.kernel.modes import Mode

_GID_BYTES = 16


class EventType(IntEnum):
    """What happened, by its number in ServiceEventInfo.msg; two further numbers are of clients."""

    RECEIVED = 1
    SENT = 2


@dataclass(frozen=True, slots=True)
class Service:
    """A service; `estop` has no field for a mode, and always requests EMERGENCY_STOP."""

    name: str
    type_name: str
    has_mode: bool


SERVICES = (
    Service("set_mode", "robot_controller/srv/SetMode_Event", True),
    Service("estop", "std_srvs/srv/Trigger_Event", False),
)


class RecordedAnswer(NamedTuple):
    """A response: whether the request was granted, its text, and the mode after it if it has one.

    `publish_ns` is when it was sent, since the epoch.
    """

    ok: bool
    text: str
    mode: int | None
    publish_ns: int


class ServiceEvent(NamedTuple):
    """An event of a server; `call` identifies the call by client and number.

    `requested` is the number of the mode in a request, None in a response.
    """

    call: tuple[bytes, int]
    requested: int | None
    answer: RecordedAnswer | None


def read_service_event(service: Service, data: bytes, publish_ns: int) -> ServiceEvent | None:
    """Return the event in a message, None if it is one of a client.

    Raises:
        struct.error: The message cannot be read.
    """
    reader = CdrReader(data)
    (kind,) = reader.take("B")
    reader.take("I", 2)  # the stamp
    client = reader.octets(_GID_BYTES)
    (number,) = reader.take("q")
    if kind not in (EventType.RECEIVED, EventType.SENT):
        return None
    call = client, number
    (has_request,) = reader.take("I")
    requested = reader.take("B")[0] if has_request else None
    (has_response,) = reader.take("I")
    if kind == EventType.RECEIVED:
        if requested is None:
            raise struct.error("a call without a request")
        return ServiceEvent(
            call, requested if service.has_mode else Mode.EMERGENCY_STOP.value, None
        )
    if not has_response:
        raise struct.error("a response without contents")
    ok, text = bool(reader.take("B")[0]), reader.text()
    mode = reader.take("B")[0] if service.has_mode else None
    return ServiceEvent(call, None, RecordedAnswer(ok, text, mode, publish_ns))
