"""Messages can be taken from a buffer at any step of packing, each exactly once."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from hypothesis import example, given
from hypothesis import strategies as st

from robotctl.recording.format.records import MESSAGE_HEAD
from robotctl.recording.write.buffer import PackBuffer, PackedMessages, pack
from tests.support.recordings import number_of, numbered


def packing(buffer: PackBuffer, number: int, channel: int, log_ns: int) -> Iterator[None]:
    """Pack a message as the recorder does; yield at each point where the threads may switch."""
    record = MESSAGE_HEAD.pack(5, 22 + 52, channel, number, log_ns, 0) + numbered(number)
    start = buffer.end
    buffer.unordered.add(channel)
    yield
    buffer.data[start : start + len(record)] = record
    yield
    buffer.indexes[channel].append(log_ns)
    yield
    buffer.indexes[channel].append(start)
    yield
    buffer.end = start + len(record)


def numbers_in(packed: PackedMessages) -> list[int]:
    """Return the messages that the indexes point to, and check that no other is there."""
    data = b"".join(bytes(part) for part in packed.parts)
    entries = []
    times = []
    for channel, index in packed.indexes.items():
        for log_ns, offset in zip(index[::2], index[1::2], strict=True):
            head = MESSAGE_HEAD.unpack_from(data, offset)
            assert (head[0], head[2], head[4]) == (5, channel, log_ns)
            entries.append((offset, number_of(data[offset + MESSAGE_HEAD.size :])))
            times.append(log_ns)
    assert [offset for offset, _ in sorted(entries)] == list(range(0, len(data), 83))
    assert (packed.start_ns, packed.end_ns) == (min(times), max(times))
    return [number for _, number in sorted(entries)]


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 2**64 - 1), st.sets(st.integers(0, 4))),
        max_size=40,
    )
)
@example([(0, 1, set()), (0, 2, {3}), (1, 3, {2}), (0, 4, {1, 2, 3, 4})])
def test_what_is_taken_at_any_step_is_each_message_once_and_in_order(
    messages: list[tuple[int, int, set[int]]],
) -> None:
    buffer = PackBuffer(40 * 83)
    buffer.make_indexes(3)
    found: list[int] = []

    def take() -> None:
        packed = buffer.take()
        if packed is not None:
            found.extend(numbers_in(packed))

    for number, (channel, log_ns, takes_at) in enumerate(messages):
        for step, _ in enumerate(packing(buffer, number, channel, log_ns)):
            if step in takes_at:
                take()
        if 4 in takes_at:
            take()
    take()
    assert found == list(range(len(messages)))
    assert buffer.take() is None


def test_a_recycled_buffer_is_as_new() -> None:
    buffer = PackBuffer(83)
    buffer.make_indexes(1)
    for number in range(3):
        list(packing(buffer, number, 0, 1000 - number))
        buffer.limit = 0
        packed = buffer.take()
        assert packed is not None
        assert numbers_in(packed) == [number]
        buffer.recycle()
        assert (buffer.end, buffer.limit, buffer.unordered) == (0, 83, set())


def test_messages_packed_without_a_buffer_are_indexed_alike() -> None:
    packed = pack([(number % 2, numbered(number), 7 - number, 0, number) for number in range(5)])
    assert numbers_in(packed) == list(range(5))
    assert struct.unpack_from("<I", packed.parts[2], 11) == (1,)
