"""Lines out of pieces of a stream."""

from __future__ import annotations


class Lines:
    """Cuts what comes in pieces into lines; the rest waits for the next piece."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """The lines that the piece ends."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        return whole
