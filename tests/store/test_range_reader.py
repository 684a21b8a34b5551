"""Ranges are asked for ahead, together, and once; what is kept has a limit."""

from __future__ import annotations

import random
from concurrent.futures import Future
from itertools import pairwise

import pytest

from robotctl.store import StoreFailed
from robotctl.store.range_cache import KEPT_BYTES, RangeCache
from robotctl.store.range_reader import MAX_READ_BYTES, RangeReader
from robotctl.store.store_errors import StoreError

KIB = 1 << 10
MIB = 1 << 20


class Served:
    """An object whose every eight bytes tell their offset; it counts the requests."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.asked: list[tuple[int, int]] = []
        self.failure: StoreError | None = None

    def fetch(self, begin: int, end: int) -> Future[bytes]:
        assert 0 <= begin < end <= self.size
        self.asked.append((begin, end))
        answer: Future[bytes] = Future()
        if self.failure is None:
            answer.set_result(self.content(begin, end))
        else:
            answer.set_exception(self.failure)
        return answer

    def content(self, begin: int, end: int) -> bytes:
        first = begin // 8
        words = b"".join(n.to_bytes(8, "big") for n in range(first, (end + 7) // 8))
        return words[begin - 8 * first : end - 8 * first]


def reader_of(served: Served, cache: RangeCache | None = None) -> RangeReader:
    return RangeReader(served.size, served.fetch, cache or RangeCache())


@pytest.mark.parametrize("seed", range(20))
def test_any_reads_return_what_is_there(seed: int) -> None:
    chance = random.Random(seed)
    served = Served(chance.randrange(1, 2 * MIB))
    reader = reader_of(served)
    for _ in range(60):
        offset, length = chance.randrange(served.size), chance.randrange(200 * KIB)
        if chance.random() < 0.1:
            reader.expect([(chance.randrange(served.size), 50 * KIB) for _ in range(5)])
        end = min(offset + length, served.size)
        assert reader.read(offset, length) == served.content(offset, end)
    covered = sorted(served.asked)
    assert all(end <= begin for (_, end), (begin, _) in pairwise(covered))


def test_small_reads_side_by_side_are_one_request() -> None:
    served = Served(10 * MIB)
    reader = reader_of(served)
    for offset in range(0, 60 * KIB, 100):
        reader.read(offset, 100)
    reader.read(10 * MIB - 37, 37)
    reader.read(10 * MIB - 9000, 5000)
    assert len(served.asked) == 2


def test_what_is_expected_is_under_way_before_it_is_read() -> None:
    served = Served(100 * MIB)
    reader = reader_of(served)
    reader.expect((offset, 2000) for offset in range(MIB, 90 * MIB, MIB))
    assert len(served.asked) == 32
    for number, offset in enumerate(range(MIB, 90 * MIB, MIB), 1):
        reader.read(offset, 90)
        reader.read(offset + 90, 1910)
        assert len(served.asked) == min(number + 32, 89)


def test_expected_ranges_that_are_near_are_one_request_and_large_ones_several() -> None:
    served = Served(100 * MIB)
    reader_of(served).expect([(0, 1000), (2000, 1000), (20 * KIB, 1000), (50 * MIB, 9 * MIB)])
    assert [end - begin for begin, end in served.asked] == [
        20 * KIB + 1000,
        4 * MIB,
        4 * MIB,
        1 * MIB,
    ]


def test_reading_from_start_to_end_takes_larger_and_larger_requests() -> None:
    served = Served(12 * MIB)
    reader = reader_of(served)
    for offset in range(0, served.size, 100 * KIB):
        reader.read(offset, 100 * KIB)
    assert len(served.asked) < 10
    assert sum(end - begin for begin, end in served.asked) == served.size


def test_what_is_kept_of_all_objects_has_one_limit() -> None:
    cache = RangeCache()
    readers = [reader_of(Served(30 * MIB), cache) for _ in range(4)]
    for reader in readers:
        for offset in range(0, 30 * MIB, MIB):
            reader.read(offset, KIB)
    assert cache.kept_bytes <= KEPT_BYTES


def test_a_failure_is_told_again_without_another_request() -> None:
    served = Served(MIB)
    reader = reader_of(served)
    served.failure = StoreFailed("gone")
    for _ in range(3):
        with pytest.raises(StoreFailed, match="gone"):
            reader.read(0, 10)
    assert len(served.asked) == 1


def test_no_read_is_larger_than_any_part_of_a_recording() -> None:
    served = Served(10**15)
    with pytest.raises(StoreError, match="claims to have"):
        reader_of(served).read(0, MAX_READ_BYTES + 1)
    assert served.asked == []
