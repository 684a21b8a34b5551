"""The bytes of the protocol are those of Foxglove's own SDK."""

from __future__ import annotations

import json

from robotctl.view.foxglove_messages import (
    StatusLevel,
    message_head,
    status,
)

# What foxglove-sdk 0.30.3 sends for the same values.
MESSAGE = "01 07 00 00 00 7b 00 00 00 00 00 00 00 00 01 00 00 68 65 6c 6c 6f"


def test_binary_messages_are_those_of_the_sdk() -> None:
    assert message_head(7, 123) + b"\x00\x01\x00\x00hello" == bytes.fromhex(MESSAGE)


def test_a_status_has_an_id_only_where_it_replaces_another() -> None:
    assert json.loads(status(StatusLevel.WARNING, "hi", "a")) == {
        "op": "status",
        "level": 1,
        "message": "hi",
        "id": "a",
    }
    assert "id" not in json.loads(status(StatusLevel.INFO, "hi"))
