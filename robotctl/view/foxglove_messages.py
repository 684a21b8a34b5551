"""What a server of the Foxglove WebSocket protocol sends.

The protocol is that of https://github.com/foxglove/ws-protocol (docs/spec.md). Integers are
little-endian, times are in nanoseconds.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The names under which Foxglove and Lichtblick ask for it."""

_MESSAGE_DATA: Final = struct.Struct("<BIQ")
_SERVICE_RESPONSE: Final = struct.Struct("<BIII")


class StatusLevel(IntEnum):
    """How serious a status message is."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class ViewChannel:
    """A topic that is offered; its messages are CDR, its definition a text."""

    id: int
    topic: str
    type_name: str
    definition: str


@dataclass(frozen=True, slots=True)
class ViewService:
    """A service without parameters that is offered; its response has `success` and `message`."""

    id: int
    name: str


def server_info(name: str, session_id: str, capabilities: Iterable[str]) -> str:
    """Return the greeting."""
    info = {
        "op": "serverInfo",
        "name": name,
        "capabilities": list(capabilities),
        "supportedEncodings": ["json"],  # of what a viewer publishes
        "metadata": {"ROS_DISTRO": "jazzy"},
        "sessionId": session_id,
    }
    return json.dumps(info)


def advertise(channels: Iterable[ViewChannel]) -> str:
    """Return the offer of channels."""
    offered = [
        {
            "id": each.id,
            "topic": each.topic,
            "encoding": "cdr",
            "schemaName": each.type_name,
            "schemaEncoding": "ros2msg",
            "schema": each.definition,
        }
        for each in channels
    ]
    return json.dumps({"op": "advertise", "channels": offered})


def unadvertise(channel_ids: Iterable[int]) -> str:
    """Return the end of an offer of channels."""
    return json.dumps({"op": "unadvertise", "channelIds": list(channel_ids)})


def status(level: StatusLevel, message: str, id: str = "") -> str:  # noqa: A002 - the field's name
    """Return a status message; one with an id replaces that of the same id."""
    said: dict[str, Any] = {"op": "status", "level": level.value, "message": message}
    return json.dumps(said | ({"id": id} if id else {}))


def remove_status(ids: Iterable[str]) -> str:
    """Return the end of status messages."""
    return json.dumps({"op": "removeStatus", "statusIds": list(ids)})


def advertise_services(services: Iterable[ViewService]) -> str:
    """Return the offer of services, all of type std_srvs/srv/Trigger, called with JSON."""

    def side(kind: str, properties: Mapping[str, Any]) -> dict[str, str]:
        schema = json.dumps({"type": "object", "properties": properties})
        name = f"std_srvs/srv/Trigger_{kind}"
        form = {"encoding": "json", "schemaEncoding": "jsonschema"}
        return {**form, "schemaName": name, "schema": schema}

    answer = {"success": {"type": "boolean"}, "message": {"type": "string"}}
    offered = [
        {
            "id": each.id,
            "name": each.name,
            "type": "std_srvs/srv/Trigger",
            "request": side("Request", {}),
            "response": side("Response", answer),
        }
        for each in services
    ]
    return json.dumps({"op": "advertiseServices", "services": offered})


def service_response(service_id: int, call_id: int, answer: Mapping[str, Any]) -> bytes:
    """Return the response to a call, in JSON."""
    encoding = b"json"
    head = _SERVICE_RESPONSE.pack(3, service_id, call_id, len(encoding))
    return head + encoding + json.dumps(answer).encode()


def service_failure(service_id: int, call_id: int, message: str) -> str:
    """Return that a call failed."""
    said = {"serviceId": service_id, "callId": call_id, "message": message}
    return json.dumps({"op": "serviceCallFailure", **said})


def message_head(subscription_id: int, log_ns: int) -> bytes:
    """Return what precedes the CDR bytes of a message."""
    return _MESSAGE_DATA.pack(1, subscription_id, log_ns)
