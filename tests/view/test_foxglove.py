"""The bytes of the protocol are those of Foxglove's own SDK; requests are decoded strictly."""

from __future__ import annotations

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.view.foxglove import (
    ClientMessage,
    ClientOffers,
    ClientWithdrawal,
    Offer,
    Subscribe,
    Unsubscribe,
    WrongRequest,
    binary_request,
    message_head,
    text_request,
)

# What foxglove-sdk 0.30.3 sends for the same values.
MESSAGE = "01 07 00 00 00 7b 00 00 00 00 00 00 00 00 01 00 00 68 65 6c 6c 6f"


def test_binary_messages_are_those_of_the_sdk() -> None:
    assert message_head(7, 123) + b"\x00\x01\x00\x00hello" == bytes.fromhex(MESSAGE)


def test_subscriptions_are_pairs_of_ids() -> None:
    text = b'{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}]}'
    assert text_request(text) == Subscribe({7: 1})
    text = b'{"op": "unsubscribe", "subscriptionIds": [7, 8]}'
    assert text_request(text) == Unsubscribe([7, 8])


def test_what_a_viewer_publishes_is_read() -> None:
    text = (
        b'{"op": "advertise", "channels": [{"id": 5, "topic": "/t", "encoding": "json",'
        b' "schemaName": "geometry_msgs/msg/Twist"}]}'
    )
    offer = Offer(5, "/t", "json", "geometry_msgs/msg/Twist")
    assert text_request(text) == ClientOffers([offer])
    assert binary_request(b"\x01\x05\0\0\0{}") == ClientMessage(5, b"{}")
    text = b'{"op": "unadvertise", "channelIds": [5]}'
    assert text_request(text) == ClientWithdrawal([5])


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{bad",
        b"[]",
        b"{}",
        b'{"op": "advertise", "channels": [{"id": 1}]}',
        b'{"op": "setParameters"}',
        b'{"op": "subscribe"}',
        b'{"op": "subscribe", "subscriptions": [3]}',
        b'{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
        b'{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        b'{"op": "subscribe", "subscriptions": [{"id": 1e400, "channelId": 1}]}',
        b"[" * 100_000,
        b'"\xff"',
    ],
)
def test_other_texts_are_refused_with_one_error(text: bytes) -> None:
    with pytest.raises(WrongRequest):
        text_request(text)


def test_other_bytes_are_refused_with_one_error() -> None:
    for data in (b"", b"\1\0", b"\x09", b"\2\0", struct.pack("<BBfBQI", 3, 0, 2.0, 1, 5, 0)):
        with pytest.raises(WrongRequest):
            binary_request(data)


@given(st.binary(max_size=64))
def test_no_bytes_raise_anything_else(data: bytes) -> None:
    for decode in (text_request, binary_request):
        with suppress(WrongRequest):
            decode(data)
