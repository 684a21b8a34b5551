"""A writer whose MCAP file is complete and valid after every write.

Each `commit` appends the new records to the data, followed by a complete trailer: DataEnd, summary,
footer, magic. The next commit overwrites that trailer. So a reader can open the file at any moment,
also after the process was killed, without a recovery step.

A positioned write is not atomic: Linux checks for fatal signals between pages. A kill during a
write can only damage what that write puts in the place of a trailer or behind it. The file is at
risk for as long as such a write takes. A commit therefore chooses the cheaper of two ways:

- A chunk smaller than the trailer is written together with the new trailer, in one write.
- A larger chunk would extend the risk by its own size. It is written in an order that keeps
  the file valid between any two writes, and no write puts a trailer at risk for longer than it
  takes to write a few hundred bytes:
  (1) far behind the old trailer, at the future end of the file: a footer that points back to it;
  (2) before that footer: the message indexes and a copy of the old trailer, where they belong
  behind the chunk; (3) the footer of that copy: from now on, readers of the index do not need the
  old trailer;
  (4) in place of the old trailer: the head of a record that sequential readers skip, as long as
  the chunk; (5) the chunk in that record; (6) the opcode of the chunk;
  (7) the end of the new trailer, the only part that has changed; (8) the checksum of the data,
  which (2) had left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)

from robotctl.recording.disk.storage import Buffer, Storage
from robotctl.recording.format.records import (
    MAGIC,
    RECORD_HEAD_BYTES,
    UNWRITTEN_CHUNK,
    Chunk,
    PlacedChunk,
    place,
    record_bytes,
)
from robotctl.recording.format.trailer import FOOTER_BYTES, Summary, TrailerState, WrittenFile
from robotctl.recording.write.file_seal import FileSeal


class McapFile:
    """The only writer of one MCAP file. Not thread-safe.

    The `add_` methods collect records; the next `commit` writes them.
    """

    def __init__(
        self, storage: Storage, *, profile: str, library: str, seal: FileSeal | None = None
    ) -> None:
        """Begin the file; nothing is written before the first `commit`. `seal` chains its bytes."""
        self.summary = Summary()
        self.size = 0
        """Bytes of the file, trailer included."""

        self.trailer_bytes = 0
        """Bytes of trailers written so far, including those that were overwritten."""

        self._storage = storage
        self._pending = bytearray(MAGIC + record_bytes(Header(profile, library)))
        self._data_end = 0
        self._data_crc = 0
        self._seal = seal
        self._sealed_pending = 0
        """Bytes of `_pending` that the seal covers already."""

        self._good: TrailerState | None = None
        """The state after the last successful write."""

    @classmethod
    def resume(cls, storage: Storage, written: WrittenFile) -> Self:
        """Return a writer that continues a finished file: new records go between its data and a new
        trailer.
        """
        self = cls(storage, profile="", library="")
        self._pending.clear()
        self._data_end = written.data_end
        self._data_crc = written.data_crc
        self.summary = Summary.of(written)
        return self

    def add_schema(self, schema: Schema) -> None:
        """Add a schema; its id must be new and not 0."""
        data = record_bytes(schema)
        self._pending += data
        self.summary.add(Opcode.SCHEMA, data)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel; its id must be new, and its schema must have been added."""
        data = record_bytes(channel)
        self._pending += data
        self.summary.add(Opcode.CHANNEL, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named map of strings. Text that is not UTF-8 (from a file name, say) is escaped."""
        plain = {_utf8(key): _utf8(value) for key, value in values.items()}
        data = record_bytes(Metadata(name=name, metadata=plain))
        offset = self._data_end + len(self._pending)
        index = MetadataIndex(offset=offset, length=len(data), name=name)
        self._pending += data
        self.summary.add(Opcode.METADATA_INDEX, record_bytes(index))

    def add_attachment(self, attachment: Attachment) -> None:
        """Add an attachment."""
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
        """Add a record of the seal."""
        self._pending += record

    def commit(self, chunk: Chunk | None = None, *, finished: bool = True) -> None:
        """Write the added records, then `chunk`, then the trailer.

        With `finished` False the trailer is left out, and the file is not valid before another
        commit: use that for files that are not read before they are complete.

        Raises:
            OSError: The file may be torn until `cut_back` has repaired it.
        """
        if self._seal is not None and self._seal.link_is_due:
            self._add_link(self._seal)
        if chunk is not None and finished and self._is_larger_than_trailer(chunk):
            if self._pending:
                self._commit_at_once(None, finished=True)
            if self._good is not None and self._is_larger_than_trailer(chunk):
                self._commit_in_order(chunk, self._good)
                return
        self._commit_at_once(chunk, finished=finished)

    def _is_larger_than_trailer(self, chunk: Chunk) -> bool:
        return self._good is not None and chunk.stored_size >= self.size - self._data_end

    def _commit_at_once(self, chunk: Chunk | None, *, finished: bool) -> None:
        parts: list[Buffer] = [bytes(self._pending)]
        end = self._data_end + len(self._pending)
        if chunk is not None:
            placed = place(chunk, end)
            parts += [placed.head, *placed.parts, placed.message_indexes]
            end = placed.end
            self._sum_up(chunk, placed)
        parts[0] = parts[0][self._sealed_pending :]
        seal = self._seal_over(parts, end)
        parts[0] = bytes(self._pending)
        state = self.summary.state(end, self._crc_with(parts), seal)
        trailer = self.summary.trailer(state) if finished else None
        self._storage.write_at([*parts, *(trailer.parts if trailer else ())], self._data_end)
        self._pending.clear()
        self._sealed_pending = 0
        self._data_end = end
        self._data_crc = state.data_crc
        self.size = end
        if trailer:
            self.size += trailer.size
            self.trailer_bytes += trailer.size
            self._good = state

    def _commit_in_order(self, chunk: Chunk, good: TrailerState) -> None:
        start = self._data_end
        placed = place(chunk, start)
        moved = self.summary.trailer(good.moved_to(placed.end))
        write_at = self._storage.write_at
        footer_offset = placed.end + moved.size - FOOTER_BYTES
        write_at([good.distant_footer()], footer_offset)
        write_at([placed.message_indexes, *moved.before_footer], placed.indexes_offset)
        write_at([moved.footer], footer_offset)
        self.trailer_bytes += moved.size + FOOTER_BYTES
        del moved  # the summary cannot grow while a memoryview of it exists

        opcode, length = placed.head[:1], placed.head[1:RECORD_HEAD_BYTES]
        write_at([UNWRITTEN_CHUNK, length], start)
        body = [placed.head[RECORD_HEAD_BYTES:], *placed.parts]
        write_at(body, start + RECORD_HEAD_BYTES)
        write_at([opcode], start)

        self._sum_up(chunk, placed)
        parts = [placed.head, *placed.parts, placed.message_indexes]
        crc = self._crc_with(parts)
        state = self.summary.state(placed.end, crc, self._seal_over(parts, placed.end))
        trailer = self.summary.trailer(state)
        changed = trailer.behind(good.kept_bytes)
        write_at(changed, placed.end + good.kept_bytes)
        write_at([trailer.data_end], placed.end)
        self.trailer_bytes += sum(map(len, changed))
        self._data_end = placed.end
        self._data_crc = crc
        self.size = placed.end + trailer.size
        self._good = state

    def _add_link(self, seal: FileSeal) -> None:
        """Add a stored link behind what is pending."""
        seal.cover(memoryview(bytes(self._pending))[self._sealed_pending :])
        record = seal.link(self._data_end + len(self._pending))
        self._sealed_pending = len(self._pending)
        self._pending += record

    def _seal_over(self, parts: Sequence[Buffer], end: int) -> bytes:
        """Return the head of the seal after `parts`, which end at the offset `end`."""
        if self._seal is None:
            return b""
        for part in parts:
            self._seal.cover(part)
        return self._seal.head(end)

    def _sum_up(self, chunk: Chunk, placed: PlacedChunk) -> None:
        self.summary.count(chunk)
        self.summary.add(Opcode.CHUNK_INDEX, record_bytes(placed.entry))

    def _crc_with(self, parts: Sequence[Buffer]) -> int:
        """Return the checksum of the data followed by `parts`; 0 (unknown) if that of the data is
        0.
        """
        if not self._data_crc and self._data_end:
            return 0
        crc = self._data_crc
        for part in parts:
            crc = crc32(part, crc)
        return crc

    def cut_back(self) -> None:
        """Restore the file to its state after the last successful commit. Call it after a failed
        one.

        Nothing may be added or committed afterwards.

        Raises:
            OSError: The file cannot be written.
        """
        good = self._good
        self.summary.go_back_to(good)
        if good is None:
            self._storage.truncate(0)
            return
        trailer = self.summary.trailer(good)
        self._storage.write_at(trailer.parts, good.data_end)
        self._storage.truncate(good.data_end + trailer.size)

    def sync(self) -> None:
        """Force everything committed to the disk.

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
