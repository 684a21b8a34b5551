"""What waits to be sent to one viewer, bounded: a slow viewer loses its oldest messages."""

from __future__ import annotations

import struct
from collections import deque
from typing import Final

LARGE_BYTES: Final = 1 << 16
"""Larger messages, as images and point clouds, have a queue of their own: they displace no small
ones."""

MAX_MESSAGES: Final = 1024
"""Limit on the waiting messages, and on the waiting large messages."""

MAX_BYTES: Final = 256 << 10
"""Limit on the bytes of either: 100 stalled viewers hold 50 MB. One larger message may wait alone.
Viewers of the same topics share the bytes, and hold hardly more than one viewer does."""

MAX_CONTROL_BYTES: Final = 16 << 20
"""Limit on the bytes of offers, states and answers, which are never dropped. One larger offer may
wait alone: 5,000 topics of nav_msgs/msg/Odometry have one of 19 MB."""

PIECE_BYTES: Final = 1 << 16
"""How much is taken at once: a transport copies what the socket does not take."""

TEXT: Final = 0x81
BINARY: Final = 0x82
"""The first byte of a WebSocket frame that is a whole message (RFC 6455, 5.2)."""


def frame_head(kind: int, length: int) -> bytes:
    """Return the head of a server's frame, which is not masked (RFC 6455, 5.2)."""
    if length < 126:
        return bytes((kind, length))
    if length < 1 << 16:
        return struct.pack("!BBH", kind, 126, length)
    return struct.pack("!BBQ", kind, 127, length)


class OverfullOutbox(Exception):
    """More offers, states and answers wait than MAX_CONTROL_BYTES allows."""


class Outbox:
    """Frames to send: first offers, states and answers, then messages, then large messages."""

    def __init__(self) -> None:
        self._control: deque[bytes] = deque()
        self._control_bytes = 0
        self._messages = _Lane()
        self._large = _Lane()
        self._begun: memoryview = memoryview(b"")
        """The rest of a frame whose beginning was taken: no other frame may come between."""

    def __bool__(self) -> bool:
        """Return whether anything waits."""
        return bool(self._begun or self._control or self._messages or self._large)

    @property
    def dropped(self) -> int:
        """How many messages of topics were removed unsent."""
        return self._messages.dropped + self._large.dropped

    @property
    def waits_for_control(self) -> bool:
        """Whether offers, states or answers wait."""
        return bool(self._control)

    def put_control(self, frame: bytes) -> None:
        """Add a frame that is never dropped.

        Raises:
            OverfullOutbox: The viewer takes none of them.
        """
        if self._control and self._control_bytes + len(frame) > MAX_CONTROL_BYTES:
            raise OverfullOutbox
        self._control.append(frame)
        self._control_bytes += len(frame)

    def put_message(self, head: bytes, data: bytes) -> None:
        """Add a message of a topic, and drop the oldest ones beyond the limits."""
        (self._large if len(data) > LARGE_BYTES else self._messages).put(head, data)

    def take(self) -> bytes:
        """Return the next bytes to send, about PIECE_BYTES at most; b"" where nothing waits."""
        if not self._begun and self._control:
            frame = self._control.popleft()
            self._control_bytes -= len(frame)
            self._begun = memoryview(frame)
        if self._begun:
            piece, self._begun = self._begun[:PIECE_BYTES], self._begun[PIECE_BYTES:]
            return bytes(piece)
        if self._messages:
            return self._messages.take_together()
        if self._large:
            head, data = self._large.take()
            self._begun = memoryview(data)
            return head
        return b""


class _Lane:
    """Messages in the order they were put, bounded."""

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, head: bytes, data: bytes) -> None:
        waiting = self._waiting
        waiting.append((head, data))
        self._bytes += len(data)
        while len(waiting) > MAX_MESSAGES or (self._bytes > MAX_BYTES and len(waiting) > 1):
            self.take()
            self.dropped += 1

    def take(self) -> tuple[bytes, bytes]:
        head, data = self._waiting.popleft()
        self._bytes -= len(data)
        return head, data

    def take_together(self) -> bytes:
        """Return the next messages, until they have PIECE_BYTES."""
        pieces: list[bytes] = []
        size = 0
        while self._waiting and size < PIECE_BYTES:
            pieces += self.take()
            size += len(pieces[-2]) + len(pieces[-1])
        return b"".join(pieces)
