"""The WebSocket protocol of Foxglove: the messages of a server, and the requests of its clients.

Source: https://github.com/foxglove/ws-protocol (docs/spec.md). Integers are little-endian.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The WebSocket subprotocols that Foxglove and Lichtblick request."""

_WARNING: Final = 1
_MESSAGE_DATA: Final = struct.Struct("<BIQ")
_SERVICE_RESPONSE: Final = struct.Struct("<BIII")


@dataclass(frozen=True, slots=True)
class ViewChannel:
    """An offered topic, with messages in CDR and a definition in ros2msg text."""

    id: int
    topic: str
    type_name: str
    definition: str


@dataclass(frozen=True, slots=True)
class ViewService:
    """An offered service without parameters."""

    id: int
    name: str


def server_info(name: str, session_id: str, capabilities: Iterable[str]) -> str:
    """Return the message that a viewer gets first."""
    info = {
        "op": "serverInfo",
        "name": name,
        "capabilities": list(capabilities),
        "supportedEncodings": ["json"],  # for messages that a viewer publishes
        "metadata": {"ROS_DISTRO": "jazzy"},
        "sessionId": session_id,
    }
    return json.dumps(info)


def advertise(channels: Iterable[ViewChannel]) -> str:
    """Return the message that offers channels."""
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
    """Return the message that withdraws channels."""
    return json.dumps({"op": "unadvertise", "channelIds": list(channel_ids)})


def warning(message: str, id: str = "") -> str:  # noqa: A002 - the field's name
    """Return a status message, which replaces an earlier one with the same `id`."""
    said = {"op": "status", "level": _WARNING, "message": message}
    return json.dumps(said | ({"id": id} if id else {}))


def remove_status(ids: Iterable[str]) -> str:
    """Return the message that removes the status messages with these `ids`."""
    return json.dumps({"op": "removeStatus", "statusIds": list(ids)})


def advertise_services(services: Iterable[ViewService]) -> str:
    """Return the message that offers services, all std_srvs/srv/Trigger with JSON encoding."""

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
    """Return the response to a service call, with `answer` in JSON."""
    encoding = b"json"
    head = _SERVICE_RESPONSE.pack(3, service_id, call_id, len(encoding))
    return head + encoding + json.dumps(answer).encode()


def service_failure(service_id: int, call_id: int, message: str) -> str:
    """Return the message about a failed service call."""
    said = {"serviceId": service_id, "callId": call_id, "message": message}
    return json.dumps({"op": "serviceCallFailure", **said})


def message_head(subscription_id: int, log_ns: int) -> bytes:
    """Return the bytes that precede the CDR bytes of a message."""
    return _MESSAGE_DATA.pack(1, subscription_id, log_ns)


_CLIENT_MESSAGE: Final = struct.Struct("<I")
_SERVICE_CALL: Final = struct.Struct("<III")

_MAX_ID: Final = (1 << 32) - 1


class WrongRequest(Exception):
    """A message that violates the protocol, or that this server does not support."""


@dataclass(frozen=True, slots=True)
class Subscribe:
    """A request to send the messages of `channels` (subscription id -> channel id)."""

    channels: dict[int, int]


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """A request to send no more messages for these subscription ids."""

    subscriptions: list[int]


@dataclass(frozen=True, slots=True)
class ServiceCall:
    """A request to call a service without parameters."""

    service_id: int
    call_id: int


@dataclass(frozen=True, slots=True)
class Offer:
    """A channel on which a client will publish, under an `id` of its choice."""

    id: int
    topic: str
    encoding: str
    type_name: str


@dataclass(frozen=True, slots=True)
class ClientOffers:
    """A notice that the client will publish on these channels."""

    offers: list[Offer]


@dataclass(frozen=True, slots=True)
class ClientWithdrawal:
    """A notice that the client will no longer publish on the channels with these ids."""

    ids: list[int]


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """A message that a client publishes on the channel `id` of its `Offer`."""

    id: int
    data: bytes


ViewRequest = (
    Subscribe | Unsubscribe | ServiceCall | ClientOffers | ClientWithdrawal | ClientMessage
)


def text_request(text: bytes) -> ViewRequest:
    """Return the request in a text message of a client.

    Raises:
        WrongRequest: The message violates the protocol, or this server does not support it.
    """
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        raise WrongRequest("a message that is no JSON") from None
    match said:
        case {"op": "subscribe", "subscriptions": list(wanted)}:
            return Subscribe({_id(each, "id"): _id(each, "channelId") for each in wanted})
        case {"op": "unsubscribe", "subscriptionIds": list(ids)}:
            return Unsubscribe([_checked_id(each) for each in ids])
        case {"op": "advertise", "channels": list(offers)}:
            return ClientOffers([_offer(each) for each in offers])
        case {"op": "unadvertise", "channelIds": list(ids)}:
            return ClientWithdrawal([_checked_id(each) for each in ids])
        case {"op": str(op)}:
            raise WrongRequest(f"this view does not take {op[:40]!r}")
    raise WrongRequest("a message without an operation")


def binary_request(data: bytes) -> ViewRequest:
    """Return the request in a binary message of a client.

    Raises:
        WrongRequest: The message violates the protocol, or this server does not support it.
    """
    opcode, content = data[:1], data[1:]
    try:
        if opcode == b"\x01":
            (channel_id,) = _CLIENT_MESSAGE.unpack_from(content)
            return ClientMessage(channel_id, content[_CLIENT_MESSAGE.size :])
        if opcode == b"\x02":
            return ServiceCall(*_SERVICE_CALL.unpack_from(content)[:2])
    except struct.error:
        raise WrongRequest("a binary message that is cut off") from None
    raise WrongRequest("a binary message of an unknown kind")


def _offer(given: Any) -> Offer:
    match given:
        case {
            "id": id_,
            "topic": str(topic),
            "encoding": str(encoding),
            "schemaName": str(type_name),
        }:
            return Offer(_checked_id(id_), topic, encoding, type_name)
    raise WrongRequest("a channel without id, topic, encoding or schemaName")


def _id(given: Any, name: str) -> int:
    if not isinstance(given, dict):
        raise WrongRequest("a subscription that is no object")
    return _checked_id(given.get(name))


def _checked_id(given: Any) -> int:
    if type(given) is not int or not 0 <= given <= _MAX_ID:
        raise WrongRequest("an id that is no uint32")
    return given
