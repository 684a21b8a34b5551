"""A file at a URL is read by few ranges; a URL of more than a file is answered with the way."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.base.store import StoreError, StoreFailed
from robotctl.base.store.remote_file import MAX_READ_BYTES, RangeReader, RemoteFile, path_of

KIB = 1 << 10
MIB = 1 << 20


class Served:
    """An object whose every eight bytes tell their offset; it counts the requests."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.asked: list[tuple[int, int]] = []
        self.failure: StoreError | None = None

    def fetch(self, begin: int, end: int) -> bytes:
        assert 0 <= begin < end <= self.size
        self.asked.append((begin, end))
        if self.failure is not None:
            raise self.failure
        return self.content(begin, end)

    def content(self, begin: int, end: int) -> bytes:
        first = begin // 8
        words = b"".join(n.to_bytes(8, "big") for n in range(first, (end + 7) // 8))
        return words[begin - 8 * first : end - 8 * first]


def reader_of(served: Served) -> RangeReader:
    return RangeReader(served.size, served.fetch)


@pytest.mark.parametrize("seed", range(20))
def test_any_reads_return_what_is_there(seed: int) -> None:
    chance = random.Random(seed)
    served = Served(chance.randrange(1, 2 * MIB))
    reader = reader_of(served)
    for _ in range(60):
        offset, length = chance.randrange(served.size), chance.randrange(200 * KIB)
        end = min(offset + length, served.size)
        assert reader.read(offset, length) == served.content(offset, end)


def test_small_reads_side_by_side_are_one_request() -> None:
    served = Served(10 * MIB)
    reader = reader_of(served)
    for offset in range(0, 60 * KIB, 100):
        reader.read(offset, 100)
    reader.read(10 * MIB - 37, 37)
    reader.read(10 * MIB - 9000, 5000)
    assert len(served.asked) == 2


def test_reading_from_start_to_end_takes_larger_and_larger_requests() -> None:
    served = Served(12 * MIB)
    reader = reader_of(served)
    for offset in range(0, served.size, 100 * KIB):
        reader.read(offset, 100 * KIB)
    assert len(served.asked) < 10
    assert sum(end - begin for begin, end in served.asked) == served.size


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


def test_a_url_of_a_file_is_a_path_of_it() -> None:
    path = path_of("s3://robots/day%201/run.mcap")
    assert isinstance(path, RemoteFile)
    assert (str(path), path.name, path.stem) == ("s3://robots/day%201/run.mcap", "run.mcap", "run")
    assert type(path_of("file:///tmp/a%20b.mcap")) is type(Path())
    assert str(path_of("file://localhost/tmp/a%20b.mcap")) == "/tmp/a b.mcap"
    with pytest.raises(UsageError, match="file of the computer 'elsewhere'"):
        path_of("file://elsewhere/run.mcap")
    with pytest.raises(UsageError, match="first robotctl sync s3://robots/day DIR"):
        path_of("s3://robots/day/")
