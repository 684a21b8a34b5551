"""Reads ranges of a large object with few requests: it asks ahead, and keeps what it has."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final

from robotctl.store.store_errors import StoreError

Range = tuple[int, int]
"""First offset, and the offset after the last [bytes]."""

_LEAST_BYTES: Final = 64 << 10
"""A smaller range takes a store about as long."""

_GAP_BYTES: Final = 32 << 10
"""Two ranges that are no further apart become one request."""

_MOST_BYTES: Final = 4 << 20
"""A larger range becomes several requests, which are under way at once."""

_AHEAD_REQUESTS: Final = 16
_AHEAD_BYTES: Final = 16 << 20
_KEPT_BYTES: Final = 48 << 20
"""Of what was read, so that it need not be asked for again."""

MAX_READ_BYTES: Final = 1 << 30
"""No part of a recording that is read at once is as large."""


@dataclass(frozen=True, slots=True)
class _Extent:
    begin: int
    end: int
    data: Future[bytes]


class RangeReader:
    """Reads one object. For one thread."""

    def __init__(self, size: int, fetch: Callable[[int, int], Future[bytes]]) -> None:
        """`fetch` starts a request for the bytes from the first offset to before the second."""
        self._size = size
        self._fetch = fetch
        self._extents: OrderedDict[int, _Extent] = OrderedDict()  # the one used last at the end
        self._begins: list[int] = []
        self._kept_bytes = 0
        self._coming: Iterator[Range] = iter(())
        self._ahead: deque[_Extent] = deque()
        self._ahead_bytes = 0
        self._window = _LEAST_BYTES
        self._missed_end = 0
        self._failure: StoreError | None = None

    def expect(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Ask ahead for ranges that will be read in this order, each an offset and a length."""
        self._coming = _requests(ranges)
        self._ask_ahead()

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`, fewer only at the end of the object.

        Raises:
            StoreError: They cannot be read; so does each later call, without another request.
        """
        if self._failure is not None:
            raise self._failure
        if length > MAX_READ_BYTES:
            raise StoreError(f"a part of it claims to have {length} bytes")
        end = min(offset + length, self._size)
        pieces = []
        try:
            while offset < end:
                extent = self._holding(offset) or self._ask(offset, end)
                data = extent.data.result()
                pieces.append(data[offset - extent.begin : end - extent.begin])
                offset = extent.end
        except StoreError as error:
            self._failure = error
            raise
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def _holding(self, offset: int) -> _Extent | None:
        number = bisect_right(self._begins, offset) - 1
        extent = self._extents[self._begins[number]] if number >= 0 else None
        if extent is None or offset >= extent.end:
            return None
        self._extents.move_to_end(extent.begin)
        if extent in self._ahead:
            while (passed := self._ahead.popleft()) is not extent:
                self._ahead_bytes -= passed.end - passed.begin
            self._ahead_bytes -= extent.end - extent.begin
            self._ask_ahead()
        return extent

    def _ask(self, offset: int, end: int) -> _Extent:
        """Ask for what was not expected; for more each time if it is read from start to end."""
        follows = offset == self._missed_end
        self._window = min(2 * self._window, _MOST_BYTES) if follows else _LEAST_BYTES
        begin, end = offset, min(max(end, offset + self._window), self._size)
        if end - begin < _LEAST_BYTES:  # the end of the object: it is read backwards
            begin = max(end - _LEAST_BYTES, 0)
        number = bisect_right(self._begins, offset)
        if number < len(self._begins):
            end = min(end, self._begins[number])
        if number:
            begin = max(begin, self._extents[self._begins[number - 1]].end)
        self._missed_end = end
        return self._start(begin, end)

    def _ask_ahead(self) -> None:
        while len(self._ahead) < _AHEAD_REQUESTS and self._ahead_bytes < _AHEAD_BYTES:
            wanted = next(self._coming, None)
            if wanted is None:
                return
            begin, end = wanted[0], min(wanted[1], self._size)
            number = bisect_right(self._begins, begin)
            if number:
                begin = max(begin, self._extents[self._begins[number - 1]].end)
            if number < len(self._begins):
                end = min(end, self._begins[number])
            if begin < end:
                self._ahead.append(self._start(begin, end))
                self._ahead_bytes += end - begin

    def _start(self, begin: int, end: int) -> _Extent:
        extent = _Extent(begin, end, self._fetch(begin, end))
        self._extents[begin] = extent
        insort(self._begins, begin)
        self._kept_bytes += end - begin
        while self._kept_bytes - self._ahead_bytes > _KEPT_BYTES and len(self._extents) > 1:
            oldest = next(each for each in self._extents.values() if each not in self._ahead)
            if oldest is extent:
                break
            del self._extents[oldest.begin]
            self._begins.remove(oldest.begin)
            self._kept_bytes -= oldest.end - oldest.begin
        return extent


def _requests(ranges: Iterable[tuple[int, int]]) -> Iterator[Range]:
    """Yield the ranges to ask for: near ones together, large ones in parts."""
    begin = end = 0
    for offset, length in ranges:
        if end and end <= offset <= end + _GAP_BYTES and offset + length - begin <= _MOST_BYTES:
            end = offset + length
            continue
        yield from _parts(begin, end)
        begin, end = offset, offset + length
    yield from _parts(begin, end)


def _parts(begin: int, end: int) -> Iterator[Range]:
    while begin < end:
        yield begin, min(begin + _MOST_BYTES, end)
        begin += _MOST_BYTES
