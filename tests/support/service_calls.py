"""Serialized events of the services that request a mode, as rclpy publishes them."""

from __future__ import annotations

import struct

from robotctl.cdr.reader import ENCAPSULATION

SET_MODE, ESTOP = "/set_mode/_service_event", "/estop/_service_event"

_HEAD = struct.Struct("<4sBxxxiI16sxxxxq")
_CLIENT = b"\x01" * 16


def received(number: int, requested: int | None) -> bytes:
    """Return the event of a call; None requests nothing, as `estop` does."""
    head = _HEAD.pack(ENCAPSULATION, 1, 0, 0, _CLIENT, number)
    return head + struct.pack("<IBxxxI", 1, requested or 0, 0)


def sent(number: int, ok: bool, text: str, mode: int | None) -> bytes:
    """Return the event of a response; `mode` is None for `estop`."""
    head = _HEAD.pack(ENCAPSULATION, 2, 0, 0, _CLIENT, number)
    message = text.encode() + b"\0"
    data = head + struct.pack("<IIBxxxI", 0, 1, ok, len(message)) + message
    return data if mode is None else data + bytes([mode])
