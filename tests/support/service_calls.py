"""Serialized events of the services that request a mode, as rclpy publishes them."""

from __future__ import annotations

import struct

from robotctl.cdr.reader import ENCAPSULATION

SET_MODE, ESTOP = "/set_mode/_service_event", "/estop/_service_event"

_LINE = "=" * 80


def _event(service: str, request: str, response: str) -> str:
    """Return the definition of the event of a service."""
    return f"""\
service_msgs/ServiceEventInfo info
{service}_Request[<=1] request
{service}_Response[<=1] response
{_LINE}
MSG: service_msgs/ServiceEventInfo
uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: {service}_Request
{request}
{_LINE}
MSG: {service}_Response
{response}
"""


EVENTS = {
    "robot_controller/srv/SetMode_Event": _event(
        "robot_controller/SetMode",
        "uint8 requested_mode",
        "bool success\nstring message\nuint8 current_mode",
    ),
    "std_srvs/srv/Trigger_Event": _event(
        "std_srvs/Trigger",
        "uint8 structure_needs_at_least_one_member",
        "bool success\nstring message",
    ),
}
"""The definitions of their types, which no .msg file holds."""

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
