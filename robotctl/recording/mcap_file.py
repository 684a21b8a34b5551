"""A writer whose MCAP file is complete and valid after every write.

Each `commit` puts, by one positioned write at the end of the data, whatever is new and then a
whole trailer: DataEnd, summary, footer, magic. The next commit overwrites that trailer. So any
reader opens the file at any moment, also after the process was killed, without a recovery step.
"""

from __future__ import annotations

from collections.abc import Mapping
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

from robotctl.recording.mcap_format import MAGIC, Chunk, chunk_bytes, record_bytes
from robotctl.recording.storage import Buffer, Storage
from robotctl.recording.trailer import Summary, TrailerState, WrittenFile


class McapFile:
    """The one writer of one MCAP file. Not thread-safe.

    Records are collected by the `add_` methods and reach the file with the next `commit`.
    """

    def __init__(self, storage: Storage, *, profile: str, library: str) -> None:
        """Begin the file; nothing is written before the first `commit`."""
        self.summary = Summary()
        self.size = 0
        """Bytes of the file, trailer included."""

        self.trailer_bytes = 0
        """Bytes written so far that a later commit overwrote or will overwrite."""

        self._storage = storage
        self._pending = bytearray(MAGIC + record_bytes(Header(profile, library)))
        self._data_end = 0
        self._data_crc = 0
        self._good: TrailerState | None = None
        """That of the last write that succeeded."""

    @classmethod
    def resume(cls, storage: Storage, written: WrittenFile) -> Self:
        """Go on writing a finished file: what is added goes between its data and a new trailer."""
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
        """Add a channel; its id must be new and its schema added before."""
        data = record_bytes(channel)
        self._pending += data
        self.summary.add(Opcode.CHANNEL, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named map of strings; what is no UTF-8, as in a file's name, is escaped."""
        plain = {_utf8(key): _utf8(value) for key, value in values.items()}
        data = record_bytes(Metadata(name=name, metadata=plain))
        offset = self._data_end + len(self._pending)
        index = MetadataIndex(offset=offset, length=len(data), name=name)
        self._pending += data
        self.summary.add(Opcode.METADATA_INDEX, record_bytes(index))

    def add_attachment(self, attachment: Attachment) -> None:
        """Add a file of another kind."""
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

    def commit(self, chunk: Chunk | None = None, *, finished: bool = True) -> None:
        """Write what was added, then `chunk`, then the trailer, by one positioned write.

        Without the trailer (`finished` False) the file is not valid before another commit: for
        files that nobody needs before they are complete. Raises OSError; the file may then be
        torn until `cut_back` has repaired it.
        """
        parts: list[Buffer] = [bytes(self._pending)]
        end = self._data_end + len(self._pending)
        if chunk is not None:
            chunk_parts, index = chunk_bytes(chunk, end)
            parts += chunk_parts
            end = index.chunk_start_offset + index.chunk_length + index.message_index_length
            self.summary.count(chunk)
            self.summary.add(Opcode.CHUNK_INDEX, record_bytes(index))
        crc = self._data_crc
        for part in parts:
            crc = crc32(part, crc)
        state = self.summary.state(end, crc)
        trailer, trailer_size = self.summary.trailer(state) if finished else ([], 0)
        self._storage.write_at([*parts, *trailer], self._data_end)
        self._pending.clear()
        self._data_end = end
        self._data_crc = crc
        self.size = end + trailer_size
        self.trailer_bytes += trailer_size
        if finished:
            self._good = state

    def cut_back(self) -> None:
        """After a failed `commit`: restore the file as the last good commit had left it.

        Nothing may be added or committed afterwards. Raises OSError.
        """
        good = self._good
        if good is None:
            self._storage.truncate(0)
            return
        trailer, trailer_size = self.summary.trailer(good)
        self._storage.write_at(trailer, good.data_end)
        self._storage.truncate(good.data_end + trailer_size)

    def sync(self) -> None:
        """Force everything committed to the disk. Raises OSError."""
        self._storage.sync()

    def close(self) -> None:
        """Close the file as the last commit has left it. Raises OSError."""
        self._storage.close()


def _utf8(text: str) -> str:
    return text.encode(errors="backslashreplace").decode()
