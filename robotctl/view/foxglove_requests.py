"""What a client of the Foxglove WebSocket protocol asks for, decoded strictly."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, Final

_CLIENT_MESSAGE: Final = struct.Struct("<I")
_SERVICE_CALL: Final = struct.Struct("<III")

_MAX_ID: Final = (1 << 32) - 1


class WrongRequest(Exception):
    """A message that is none of the protocol, or one that this server does not take."""


@dataclass(frozen=True, slots=True)
class Subscribe:
    """Send the messages of channels: subscription id -> channel id."""

    channels: dict[int, int]


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """Send no more messages for these subscription ids."""

    subscriptions: list[int]


@dataclass(frozen=True, slots=True)
class ServiceCall:
    """Call a service that takes no parameters."""

    service_id: int
    call_id: int


@dataclass(frozen=True, slots=True)
class Offer:
    """Offer a channel of the client, with an id of the client."""

    id: int
    topic: str
    encoding: str
    type_name: str


@dataclass(frozen=True, slots=True)
class ClientOffers:
    """Offer channels of the client."""

    offers: list[Offer]


@dataclass(frozen=True, slots=True)
class ClientWithdrawal:
    """Offer these channels of the client no longer."""

    ids: list[int]


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """A message on a channel of the client."""

    id: int
    data: bytes


ViewRequest = (
    Subscribe | Unsubscribe | ServiceCall | ClientOffers | ClientWithdrawal | ClientMessage
)


def text_request(text: bytes) -> ViewRequest:
    """Decode a text message.

    Raises:
        WrongRequest: It is none of the protocol, or one that this server does not take.
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
    """Decode a binary message.

    Raises:
        WrongRequest: It is none of the protocol, or one that this server does not take.
    """
    opcode, content = data[:1], data[1:]
    try:
        if opcode == b"\x01":
            (channel_id,) = _CLIENT_MESSAGE.unpack_from(content)
            return ClientMessage(channel_id, content[_CLIENT_MESSAGE.size :])
        if opcode == b"\x02":
            return _service_call(content)
    except struct.error:
        raise WrongRequest("a binary message that is cut off") from None
    raise WrongRequest("a binary message of an unknown kind")


def _service_call(content: bytes) -> ServiceCall:
    service_id, call_id, _ = _SERVICE_CALL.unpack_from(content)
    return ServiceCall(service_id, call_id)


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
