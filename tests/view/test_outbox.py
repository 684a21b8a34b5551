"""What waits for a viewer is bounded, and frames stay whole."""

from __future__ import annotations

import pytest

from robotctl.view.outbox import (
    BINARY,
    MAX_BYTES,
    MAX_CONTROL_BYTES,
    MAX_MESSAGES,
    PIECE_BYTES,
    Outbox,
    OverfullOutbox,
    frame_head,
)


def drained(outbox: Outbox) -> bytes:
    return b"".join(iter(outbox.take, b""))


@pytest.mark.parametrize("length", [0, 125, 126, 65_535, 65_536, 1 << 20])
def test_heads_of_frames_are_those_of_the_websocket_library(length: int) -> None:
    from websockets.frames import Frame, Opcode

    data = bytes(length)
    whole = Frame(Opcode.BINARY, data).serialize(mask=False)
    assert frame_head(BINARY, length) + data == whole


def test_the_oldest_messages_are_dropped_and_counted() -> None:
    outbox = Outbox()
    for number in range(MAX_MESSAGES + 5):
        outbox.put_message(b"", number.to_bytes(4, "big"))
    assert outbox.dropped == 5
    assert drained(outbox)[:4] == (5).to_bytes(4, "big")
    assert not outbox


def test_the_bytes_that_wait_are_bounded_but_one_large_message_may_wait() -> None:
    outbox = Outbox()
    for _ in range(10):
        outbox.put_message(b"h", bytes(MAX_BYTES // 4))
    assert outbox.dropped == 6
    outbox = Outbox()
    for content in (b"x", b"y", b"z"):
        outbox.put_message(b"h", content * (8 * MAX_BYTES))
    assert outbox.dropped == 2
    assert drained(outbox) == b"h" + b"z" * (8 * MAX_BYTES)


def test_images_drop_no_small_messages() -> None:
    outbox = Outbox()
    for _ in range(3):
        outbox.put_message(b"h", b"image" * MAX_BYTES)
        outbox.put_message(b"h", b"odometry")
    assert outbox.dropped == 2
    assert drained(outbox).startswith(3 * b"hodometry" + b"himage")


def test_nothing_comes_between_the_pieces_of_a_frame() -> None:
    outbox = Outbox()
    outbox.put_message(b"h", b"x" * (2 * PIECE_BYTES))
    taken = outbox.take()
    outbox.put_control(b"c" * (PIECE_BYTES + 1))
    outbox.put_message(b"h", b"y")
    taken += drained(outbox)
    assert taken == b"h" + b"x" * (2 * PIECE_BYTES) + b"c" * (PIECE_BYTES + 1) + b"hy"


def test_small_messages_are_taken_together_but_no_more_than_a_transport_may_copy() -> None:
    outbox = Outbox()
    for _ in range(1000):
        outbox.put_message(b"head", bytes(200))
    piece = outbox.take()
    assert PIECE_BYTES <= len(piece) < PIECE_BYTES + 204


def test_offers_and_answers_are_never_dropped_but_bounded() -> None:
    outbox = Outbox()
    outbox.put_control(bytes(MAX_CONTROL_BYTES))
    with pytest.raises(OverfullOutbox):
        outbox.put_control(b"x")


def test_one_offer_above_the_limit_may_wait_alone() -> None:
    """Else no viewer could connect where there are thousands of topics."""
    outbox = Outbox()
    outbox.put_control(bytes(2 * MAX_CONTROL_BYTES))
    with pytest.raises(OverfullOutbox):
        outbox.put_control(b"x")
    outbox.take()
    outbox.put_control(b"x")
    assert len(drained(outbox)) == 2 * MAX_CONTROL_BYTES - PIECE_BYTES + 1
