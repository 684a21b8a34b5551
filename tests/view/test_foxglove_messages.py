"""The bytes of the protocol are those of Foxglove's own SDK."""

from __future__ import annotations

import json

from robotctl.view.foxglove_messages import (
    PlaybackStatus,
    StatusLevel,
    message_head,
    playback_state,
    server_info,
    status,
    time_message,
)

# What foxglove-sdk 0.30.3 sends for the same values.
MESSAGE = "01 07 00 00 00 7b 00 00 00 00 00 00 00 00 01 00 00 68 65 6c 6c 6f"
TIME = "02 05 00 00 00 00 00 00 00"
SEEK = "05 00 4d 00 00 00 00 00 00 00 00 00 00 40 01 03 00 00 00 61 62 63"
ENDED = "05 03 09 00 00 00 00 00 00 00 00 00 c0 3f 00 00 00 00 00"


def test_binary_messages_are_those_of_the_sdk() -> None:
    assert message_head(7, 123) + b"\x00\x01\x00\x00hello" == bytes.fromhex(MESSAGE)
    assert time_message(5) == bytes.fromhex(TIME)
    seek = playback_state(PlaybackStatus.PLAYING, 77, 2.0, did_seek=True, request_id="abc")
    assert seek == bytes.fromhex(SEEK)
    ended = playback_state(PlaybackStatus.ENDED, 9, 1.5, did_seek=False, request_id="")
    assert ended == bytes.fromhex(ENDED)


def test_the_greeting_tells_the_span_of_a_recording() -> None:
    info = json.loads(server_info("x", "1", ("time",), (1_500_000_000, 9_000_000_000)))
    assert info["dataStartTime"] == {"sec": 1, "nsec": 500_000_000}
    assert info["dataEndTime"] == {"sec": 9, "nsec": 0}
    assert "dataStartTime" not in json.loads(server_info("x", "1", ()))


def test_a_status_has_an_id_only_where_it_replaces_another() -> None:
    assert json.loads(status(StatusLevel.WARNING, "hi", "a")) == {
        "op": "status",
        "level": 1,
        "message": "hi",
        "id": "a",
    }
    assert "id" not in json.loads(status(StatusLevel.INFO, "hi"))
