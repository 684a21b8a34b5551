"""A writer whose MCAP file is valid after every write, also after a kill."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from typing import Final, Protocol, Self

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)

from robotctl.recording.format.disk import Buffer, Storage
from robotctl.recording.format.records import (
    DATA_END_BYTES,
    MAGIC,
    RECORD_HEAD_BYTES,
    Chunk,
    place,
    record_bytes,
    room_head,
)
from robotctl.recording.format.seal_records import Link, LinkKind, Opening, SealOfFile, chained
from robotctl.recording.format.trailer import FOOTER_BYTES, Summary, TrailerState, WrittenFile

LINK_PERIOD_S: Final = 10.0
"""Period of the links in the data [s]."""


class Sealer(Protocol):
    """The robot's signing keys, as a `FileSeal` uses them. An error ends the seal of the file."""

    def open_file(self, file: str) -> SealOfFile:
        """Return the seal of a new file."""

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Store `link` outside the recording. First sync the bytes of the file that it signs."""


class FileSeal:
    """The seal of one file: a hash chain over header and data, signed once `open` was called."""

    def __init__(self, sealer: Sealer, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin the chain at the beginning of the file. `clock` returns monotonic time [s]."""
        self._sealer = sealer
        self._clock = clock
        self._hash = sha256()
        self._base = b""
        self._number = 1
        self._seal: SealOfFile | None = None
        self._due = 0.0
        self._stored: Link | None = None
        """The last link of the file if `keep` has not stored it yet."""

        self._head: Link | None = None
        self.failure = ""
        """The reason for the end of the seal, or ""."""

    def open(self, file: str) -> bytes:
        """Begin to sign. Return the record that opens the seal, with its key, b"" on failure."""
        try:
            self._seal = self._sealer.open_file(file)
        except Exception as error:  # noqa: BLE001 - the seal never stops a recording
            self._fail(error)
            return b""
        opening = self._seal.opening
        self._base = bytes.fromhex(opening.previous)
        self._due = self._clock()  # soon, so that the next file can continue this one
        return opening.record()

    def cover(self, part: Buffer) -> None:
        """Add the next bytes of header or data to the chain."""
        self._hash.update(part)

    @property
    def link_is_due(self) -> bool:
        """Whether a link of the hash chain must be added to the data now."""
        return self._seal is not None and self._clock() >= self._due

    def link(self, covered: int) -> bytes:
        """Return a record for the data that signs the first `covered` bytes, b"" on failure."""
        link = self._signed(LinkKind.LINK, covered)
        if link is None:
            return b""
        self._stored = link
        self._base = link.digest
        self._hash = sha256()
        self._number += 1
        self._due = self._clock() + LINK_PERIOD_S
        return link.record()

    def head(self, covered: int) -> bytes:
        """Return a record for the summary that signs the first `covered` bytes, b"" on failure."""
        if self._seal is None:
            return b""
        self._head = self._signed(LinkKind.HEAD, covered)
        return b"" if self._head is None else self._head.record()

    def keep(self, *, closed: bool = False) -> None:
        """Store the last `link` (`head` if `closed`) outside the file. First sync the file."""
        link = self._head if closed else self._stored
        if self._seal is None or link is None:
            return
        self._stored = None
        try:
            self._sealer.keep(self._seal.opening, link, closed=closed)
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def _signed(self, kind: LinkKind, covered: int) -> Link | None:
        if self._seal is None:
            return None
        digest = chained(self._base, self._hash.digest())
        plain = Link(kind, self._number, covered, time.time_ns(), digest)
        try:
            return replace(plain, signature=self._seal.sign(plain.signed()))
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)
            return None

    def _fail(self, error: Exception) -> None:
        self._seal = None
        self.failure = f"the rest of this file is not sealed: {error}"


LEAST_BYTES: Final = 64 << 10
"""The least size of new room."""

PAGE_BYTES: Final = 4096

COMMITS: Final = 3
"""Number of further commits of the same size that fit into new room."""


def write_hidden(parts: Sequence[Buffer], start: int, storage: Storage) -> None:
    """Write records over the filler record at `start`. Readers skip it until all are written.

    Raises:
        OSError: The disk is full or fails. The file must be cut back.
    """
    first, *others = [memoryview(part) for part in parts if len(part)]
    storage.write_at([first[RECORD_HEAD_BYTES:], *others], start + RECORD_HEAD_BYTES)
    storage.write_at([first[:RECORD_HEAD_BYTES]], start)


def write_in_pages(parts: Sequence[Buffer], offset: int, storage: Storage) -> None:
    """Write `parts` at `offset`, one page per write.

    Raises:
        OSError: The disk is full or fails.
    """
    # Linux caches one write in a folio of up to 2 MB, and writes all of it again for each change.
    whole = memoryview(b"".join(parts))
    for start in range(0, len(whole), PAGE_BYTES):
        storage.write_at([whole[start : start + PAGE_BYTES]], offset + start)


class McapFile:
    """Writer of one MCAP file. The `add_` methods collect records for `commit`. Not thread-safe."""

    def __init__(
        self,
        storage: Storage,
        *,
        profile: str,
        library: str,
        seal: FileSeal | None = None,
        keeps_room: bool = False,
    ) -> None:
        """Begin the file without a write. `keeps_room` makes many small commits cheap."""
        self.summary = Summary()
        self.size = 0
        """Bytes of the file, trailer included, without the room between data and trailer."""

        self._storage = storage
        # A trailer directly behind the data moves with each commit: the disk writes 50 times the
        # recorded bytes in ten minutes. The room is a record before the trailer; readers skip it.
        self._keeps_room = keeps_room
        self._pending = bytearray(MAGIC + record_bytes(Header(profile, library)))
        self._data_end = 0
        self._data_crc = 0
        self._seal = seal
        self._sealed_pending = 0
        """Number of bytes at the beginning of `_pending` that the seal covers already."""

        self._good: TrailerState | None = None
        """The state after the last successful write."""

    @classmethod
    def resume(cls, storage: Storage, written: WrittenFile) -> Self:
        """Return a writer that appends to the data of a finished file, over its trailer."""
        self = cls(storage, profile="", library="")
        self._pending.clear()
        self._data_end = written.data_end
        self._data_crc = written.data_crc
        self.summary = Summary.of(written)
        return self

    def add_schema(self, schema: Schema) -> None:
        """Add a schema. Its id must be new, and not 0."""
        data = record_bytes(schema)
        self._pending += data
        self.summary.add(Opcode.SCHEMA, data)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel. Its id must be new, and its schema added before."""
        data = record_bytes(channel)
        self._pending += data
        self.summary.add(Opcode.CHANNEL, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named map of strings. Bytes that are not UTF-8 are escaped."""
        plain = {_utf8(key): _utf8(value) for key, value in values.items()}
        data = record_bytes(Metadata(name=name, metadata=plain))
        offset = self._data_end + len(self._pending)
        index = MetadataIndex(offset=offset, length=len(data), name=name)
        self._pending += data
        self.summary.add(Opcode.METADATA_INDEX, record_bytes(index))

    def add_attachment(self, attachment: Attachment) -> None:
        """Add an attachment to the pending data, and its index to the summary."""
        data = record_bytes(attachment)
        index = AttachmentIndex(
            offset=self._data_end + len(self._pending),
            length=len(data),
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._pending += data
        self.summary.add(Opcode.ATTACHMENT_INDEX, record_bytes(index))

    def add_sealed(self, record: bytes) -> None:
        """Add a record of the seal. The summary does not list it."""
        self._pending += record

    def commit(self, chunk: Chunk | None = None, *, finished: bool = True) -> None:
        """Write the records added since the last commit, then `chunk`, then a new trailer.

        If `finished` is False, there is no trailer, and the file is invalid until a later commit
        writes it. Not allowed with `keeps_room`.

        Raises:
            OSError: The file may be torn until `cut_back` has repaired it.
        """
        if self._seal is not None and self._seal.link_is_due:
            self._add_link(self._seal)
        good = self._good
        if not self._keeps_room or good is None:
            self._commit_at_once(chunk, finished=finished)
            return
        if good.group_sizes != self.summary.group_sizes():
            good = self._commit_without_room(good)
        if chunk is not None or self._pending:
            self._commit_into_room(good, chunk)

    def _commit_at_once(self, chunk: Chunk | None, *, finished: bool) -> None:
        """Write everything directly behind the data, in one write."""
        parts, end, entry = self._parts(chunk)
        seal = self._sum_up(parts, end, chunk, entry)
        state = self.summary.state(end, self._crc_with(parts), seal)
        trailer = self.summary.trailer(state) if finished else None
        self._storage.write_at([*parts, *(trailer.parts if trailer else ())], self._data_end)
        if trailer:
            self._good = state
        self._take_over(end, end + (trailer.size if trailer else 0), state.data_crc)

    def _commit_without_room(self, good: TrailerState) -> TrailerState:
        """Write the added records with the trailer directly behind them, and return its state."""
        parts, end, _ = self._parts(None)
        state = self.summary.state(end, self._crc_with(parts), self._sum_up(parts, end))
        trailer = self.summary.trailer(state)
        size = end + trailer.size
        self._make_room(good, size - self._data_end)
        write_in_pages(trailer.parts, end, self._storage)
        write_hidden(parts, self._data_end, self._storage)
        self._storage.truncate(size)
        self._good = state
        self._take_over(end, size, state.data_crc)
        return state

    # A kill can end a write between two pages. So the file is valid between any two writes, and
    # each changes only the room, the trailer or what is behind it. The writes of a commit:
    # (1) the new records without the head of the first, and a head for the rest of the room;
    # (2) the head of the first record, which shows all of them to sequential readers;
    # (3) the end of the trailer.
    def _commit_into_room(self, good: TrailerState, chunk: Chunk | None) -> None:
        """Write the new records into the room, and update the trailer."""
        start = self._data_end
        parts, end, entry = self._parts(chunk)
        good = self._make_room(good, end - start)
        seal = self._sum_up(parts, end, chunk, entry)
        state = self.summary.state(good.data_end, 0, seal)
        trailer = self.summary.trailer(state)
        changed = trailer.behind(good.kept_bytes)
        write_hidden([*parts, room_head(end, state.data_end)], start, self._storage)
        self._storage.write_at(changed, state.data_end + good.kept_bytes)
        if trailer.size < self.size - start:  # the new trailer lacks the seal's head
            self._storage.truncate(state.data_end + trailer.size)
        self._good = state
        self._take_over(end, end + trailer.size, self._crc_with(parts))

    # The writes: (1) at the future end of the file, a footer that points back to the trailer;
    # (2) before it, a copy of the trailer; (3) the footer of the copy, so that readers of the index
    # do not need the old trailer; (4) the head of the room, which reaches to the copy.
    def _make_room(self, good: TrailerState, size: int) -> TrailerState:
        """Make room for `size` bytes before the trailer, and return the trailer's state."""
        start, storage = self._data_end, self._storage
        if size + RECORD_HEAD_BYTES > good.data_end - start:
            # At least the trailer: moving it writes about one byte for each byte recorded.
            more = max(LEAST_BYTES, self.size - start, COMMITS * size)
            moved = replace(good, data_end=good.data_end + size + more, data_crc=0)  # 0: unknown
            trailer = self.summary.trailer(moved)
            footer_offset = moved.data_end + trailer.size - FOOTER_BYTES
            pointing_back = Footer(good.data_end + DATA_END_BYTES, 0, 0)
            storage.write_at([record_bytes(pointing_back), MAGIC], footer_offset)
            write_in_pages(trailer.before_footer, moved.data_end, storage)
            storage.write_at([trailer.footer], footer_offset)
            storage.write_at([room_head(start, moved.data_end)], start)
            good = moved
        self._good = good
        return good

    def _parts(self, chunk: Chunk | None) -> tuple[list[Buffer], int, ChunkIndex | None]:
        """Return the parts to write, the offset after them, and the chunk's entry in the index."""
        pending = bytes(self._pending)
        end = self._data_end + len(pending)
        if chunk is None:
            return [pending], end, None
        placed = place(chunk, end)
        parts = [pending, placed.head, *placed.parts, placed.message_indexes]
        return parts, placed.end, placed.entry

    def _sum_up(
        self,
        parts: Sequence[Buffer],
        end: int,
        chunk: Chunk | None = None,
        entry: ChunkIndex | None = None,
    ) -> bytes:
        """Add the chunk to the summary and `parts` to the seal, and return the seal's head."""
        if chunk is not None and entry is not None:
            self.summary.count(chunk)
            self.summary.add(Opcode.CHUNK_INDEX, record_bytes(entry))
        if self._seal is None:
            return b""
        for part in (memoryview(parts[0])[self._sealed_pending :], *parts[1:]):
            self._seal.cover(part)
        return self._seal.head(end)

    def _take_over(self, data_end: int, size: int, data_crc: int) -> None:
        self._pending.clear()
        self._sealed_pending = 0
        self._data_end = data_end
        self._data_crc = data_crc
        self.size = size

    def _add_link(self, seal: FileSeal) -> None:
        """Add a link of the seal behind the pending records."""
        seal.cover(memoryview(bytes(self._pending))[self._sealed_pending :])
        record = seal.link(self._data_end + len(self._pending))
        self._sealed_pending = len(self._pending)
        self._pending += record

    def _crc_with(self, parts: Sequence[Buffer]) -> int:
        """Return the CRC of the data and `parts`, 0 (unknown) if that of the data is unknown."""
        if not self._data_crc and self._data_end:
            return 0
        crc = self._data_crc
        for part in parts:
            crc = crc32(part, crc)
        return crc

    def cut_back(self) -> None:
        """Restore the file as of the last good commit. Nothing may be added afterwards.

        Raises:
            OSError: The file cannot be written.
        """
        good = self._good
        self.summary.go_back_to(good)
        if good is None:
            self._storage.truncate(0)
            return
        trailer = self.summary.trailer(good)
        if good.data_end > self._data_end:
            self._storage.write_at([room_head(self._data_end, good.data_end)], self._data_end)
        self._storage.write_at(trailer.parts, good.data_end)
        self._storage.truncate(good.data_end + trailer.size)

    def sync(self) -> None:
        """Force everything that was committed to the disk.

        Raises:
            OSError: The disk fails, or the file was removed.
        """
        self._storage.sync()

    def close(self) -> None:
        """Close the file as the last commit left it.

        Raises:
            OSError: The disk fails.
        """
        self._storage.close()


def _utf8(text: str) -> str:
    return text.encode(errors="backslashreplace").decode()
