"""What was read of the objects of a bucket, kept in memory up to a limit."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Final

KEPT_BYTES: Final = 48 << 20


@dataclass(slots=True, eq=False)
class Extent:
    """A range of an object that was asked for, from `begin` to before `end` [bytes]."""

    begin: int
    end: int
    data: Future[bytes]
    ahead: bool
    """Whether it was fetched ahead and not read yet; then it is not dropped."""


class Extents:
    """Those of one object, which do not overlap."""

    def __init__(self, cache: RangeCache) -> None:
        self._cache = cache
        self._by_begin: dict[int, Extent] = {}
        self._begins: list[int] = []

    def holding(self, offset: int) -> Extent | None:
        """Return the one that holds the byte at `offset`."""
        number = bisect_right(self._begins, offset) - 1
        extent = self._by_begin[self._begins[number]] if number >= 0 else None
        return None if extent is None or offset >= extent.end else extent

    def free_around(self, offset: int, begin: int, end: int) -> tuple[int, int]:
        """Return the part of a range around `offset` that no extent holds; `offset` is in none."""
        number = bisect_right(self._begins, offset)
        if number < len(self._begins):
            end = min(end, self._begins[number])
        if number:
            begin = max(begin, self._by_begin[self._begins[number - 1]].end)
        return begin, end

    def add(self, extent: Extent) -> None:
        """Keep one; the oldest ones of the cache may be dropped for it."""
        self._by_begin[extent.begin] = extent
        insort(self._begins, extent.begin)
        self._cache.add(self, extent)

    def touch(self, extent: Extent) -> None:
        """Note that it was read."""
        self._cache.touch(extent)

    def drop(self, extent: Extent) -> None:
        """Forget one."""
        del self._by_begin[extent.begin]
        self._begins.remove(extent.begin)


class RangeCache:
    """The extents of many objects, the one that was read last at the end."""

    def __init__(self) -> None:
        self._owners: OrderedDict[Extent, Extents] = OrderedDict()
        self.kept_bytes = 0

    def add(self, owner: Extents, extent: Extent) -> None:
        """Keep one, and drop the oldest ones beyond the limit that need not be read any more."""
        self._owners[extent] = owner
        self.kept_bytes += extent.end - extent.begin
        if self.kept_bytes > KEPT_BYTES:
            for each in [each for each in self._owners if not each.ahead and each is not extent]:
                self._owners.pop(each).drop(each)
                self.kept_bytes -= each.end - each.begin
                if self.kept_bytes <= KEPT_BYTES:
                    return

    def touch(self, extent: Extent) -> None:
        """Note that one was read."""
        if extent in self._owners:
            self._owners.move_to_end(extent)
