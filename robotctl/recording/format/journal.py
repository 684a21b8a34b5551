"""The journal: each event, effect and snapshot of the kernel as robot_controller/JournalEntry."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple
from zlib import crc32

from robotctl.base.errors import UnreadableFile
from robotctl.messages.cdr import ENCAPSULATION, LITTLE_ENDIAN

TOPIC = "robotctl/journal"
SHADOW_TOPIC = "robotctl/shadow"
"""In files of earlier versions: the journal of a second kernel, which did not drive."""

MAX_TEXT_BYTES = 256 << 10
"""Maximum size of the JSON of an entry. A request to the kernel has at most 64 kB."""


class EntryKind(IntEnum):
    """The kind of a journal entry, with the numbers of JournalEntry.msg."""

    EVENT = 0
    EFFECT = 1
    SNAPSHOT = 2


class JournalEntry(NamedTuple):
    """One entry: `seq` counts from 0 without gaps, `t_ns` is steady time [ns], `data` is JSON."""

    seq: int
    t_ns: int
    kind: EntryKind
    name: str
    data: str


_KINDS = tuple(EntryKind)

_NAME_SIZE_AT = struct.calcsize("<4sQqBxxx")

MAX_NAME_BYTES = 255
"""Maximum size of the name of an entry, including the zero at its end."""


class _Layouts(dict[int, struct.Struct]):
    """The binary layout of an entry before its data, by the size of its name [bytes]."""

    def __missing__(self, name_bytes: int) -> struct.Struct:
        if not 0 < name_bytes <= MAX_NAME_BYTES:
            raise KeyError(name_bytes)
        # encapsulation, seq, t_ns, kind, size of the name, name, size of the data
        padding = -name_bytes % 4
        self[name_bytes] = struct.Struct(f"<4sQqBxxxI{name_bytes - 1}sx{padding}xI")
        return self[name_bytes]


_LAYOUTS: Final = _Layouts()

_new = tuple.__new__
"""Creates a named tuple in a third of the time that a call of its class takes."""


def encode(entry: JournalEntry) -> bytes:
    """Return the entry as ROS serializes it (CDR, OMG DDSI-RTPS 10.2)."""
    name, data = entry.name.encode(), entry.data.encode() + b"\0"
    name_size = len(name) + 1
    head = ENCAPSULATION, entry.seq, entry.t_ns, entry.kind, name_size, name, len(data)
    return _LAYOUTS[name_size].pack(*head) + data


def chained(serialized: bytes, crc: int) -> int:
    """Return the CRC-32 of a journal up to this entry, given the CRC before the entry."""
    return crc32(serialized.rstrip(b"\0"), crc)  # DDS pads messages with zeros


def decode(serialized: bytes) -> JournalEntry:
    """Return the entry that `encode` wrote.

    Raises:
        UnreadableFile: The bytes are not a journal entry.
    """
    try:
        layout = _LAYOUTS[serialized[_NAME_SIZE_AT]]
        encapsulation, seq, t_ns, kind, name_size, name, data_size = layout.unpack_from(serialized)
        if encapsulation[:2] != LITTLE_ENDIAN:
            raise ValueError("not little-endian CDR")
        if name_size > MAX_NAME_BYTES:
            raise ValueError(f"its name has {name_size} bytes, more than {MAX_NAME_BYTES}")
        if data_size > MAX_TEXT_BYTES:
            raise ValueError(f"its text has {data_size} bytes, more than {MAX_TEXT_BYTES}")
        end = layout.size + data_size
        if len(serialized) < end:
            raise ValueError("cut short")
        data = serialized[layout.size : end - 1].decode()
        return _new(JournalEntry, (seq, t_ns, _KINDS[kind], name.decode(), data))
    except LookupError:
        raise UnreadableFile("a journal entry is damaged: it has no name or kind") from None
    except (struct.error, ValueError) as error:
        raise UnreadableFile(f"a journal entry is damaged: {error}") from None
