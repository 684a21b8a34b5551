"""Reads ranges of a large object with few requests: it asks ahead, and keeps what it has."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Final

from robotctl.store.range_cache import Extent, Extents, RangeCache
from robotctl.store.store_errors import StoreError

_LEAST_BYTES: Final = 64 << 10
"""A smaller range takes a store about as long."""

_GAP_BYTES: Final = 32 << 10
"""Two ranges that are no further apart become one request."""

_MOST_BYTES: Final = 4 << 20
"""A larger range becomes several requests, which are under way at once."""

_AHEAD_REQUESTS: Final = 32
"""Requests at once: with 20 ms each, a check of images waits at most half of its time."""

_AHEAD_BYTES: Final = 16 << 20

MAX_READ_BYTES: Final = 1 << 30
"""No part of a recording that is read at once is as large."""


class RangeReader:
    """Reads one object. For one thread."""

    def __init__(
        self, size: int, fetch: Callable[[int, int], Future[bytes]], cache: RangeCache
    ) -> None:
        """`fetch` starts a request for the bytes from the first offset to before the second."""
        self._size = size
        self._fetch = fetch
        self._extents = Extents(cache)
        self._coming: Iterator[tuple[int, int]] = iter(())
        self._ahead: deque[Extent] = deque()
        self._ahead_bytes = 0
        self._window = _LEAST_BYTES
        self._missed_end = 0
        self._failure: StoreError | None = None

    def expect(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Ask ahead for ranges that will be read in this order, each an offset and a length."""
        while self._ahead:
            self._pass()
        self._coming = _requests(ranges)
        self._ask_ahead()

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`, fewer only at the end of the object.

        Raises:
            StoreError: They cannot be read; so does each later call, without another request.
        """
        self.check()
        if length > MAX_READ_BYTES:
            raise StoreError(f"a part of it claims to have {length} bytes")
        end = min(offset + length, self._size)
        pieces = []
        try:
            while offset < end:
                extent = self._held(offset) or self._asked(offset, end)
                data = extent.data.result()
                pieces.append(data[offset - extent.begin : end - extent.begin])
                offset = extent.end
        except StoreError as error:
            self._failure = error
            raise
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def check(self) -> None:
        """Raise what has ended the reading, if anything has.

        Raises:
            StoreError: A read has failed.
        """
        if self._failure is not None:
            raise self._failure

    def _held(self, offset: int) -> Extent | None:
        extent = self._extents.holding(offset)
        if extent is None:
            return None
        self._extents.touch(extent)
        was_ahead = extent.ahead
        while extent.ahead:
            self._pass()
        if was_ahead:
            self._ask_ahead()
        return extent

    def _asked(self, offset: int, end: int) -> Extent:
        """Ask for what was not expected; for more each time if it is read from start to end."""
        follows = offset == self._missed_end
        self._window = min(2 * self._window, _MOST_BYTES) if follows else _LEAST_BYTES
        begin, end = offset, min(max(end, offset + self._window), self._size)
        if end - begin < _LEAST_BYTES:  # the end of the object: it is read backwards
            begin = max(end - _LEAST_BYTES, 0)
        begin, end = self._extents.free_around(offset, begin, end)
        self._missed_end = end
        return self._start(begin, end, ahead=False)

    def _ask_ahead(self) -> None:
        while len(self._ahead) < _AHEAD_REQUESTS and self._ahead_bytes < _AHEAD_BYTES:
            wanted = next(self._coming, None)
            if wanted is None:
                return
            begin, end = wanted[0], min(wanted[1], self._size)
            while begin < end:
                if (held := self._extents.holding(begin)) is not None:
                    begin = held.end
                    continue
                _, free_end = self._extents.free_around(begin, begin, end)
                self._ahead.append(self._start(begin, free_end, ahead=True))
                self._ahead_bytes += free_end - begin
                begin = free_end

    def _pass(self) -> None:
        """Let the next extent that was asked for ahead be an ordinary one."""
        extent = self._ahead.popleft()
        extent.ahead = False
        self._ahead_bytes -= extent.end - extent.begin

    def _start(self, begin: int, end: int, *, ahead: bool) -> Extent:
        extent = Extent(begin, end, self._fetch(begin, end), ahead)
        self._extents.add(extent)
        return extent


def _requests(ranges: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield first and last offset of what to ask for: near ranges together, large ones in parts."""
    begin = end = 0
    for offset, length in ranges:
        if end and end <= offset <= end + _GAP_BYTES and offset + length - begin <= _MOST_BYTES:
            end = offset + length
            continue
        yield from _parts(begin, end)
        begin, end = offset, offset + length
    yield from _parts(begin, end)


def _parts(begin: int, end: int) -> Iterator[tuple[int, int]]:
    while begin < end:
        yield begin, min(begin + _MOST_BYTES, end)
        begin += _MOST_BYTES
