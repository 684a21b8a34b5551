"""Salvaging what a broken file of any writer still holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.opcode import Opcode

from robotctl.errors import UnreadableFile
from robotctl.recording.buffer import PlainMessage, pack
from robotctl.recording.chunk_encoder import ChunkEncoder
from robotctl.recording.file_index import (
    FileIndex,
    Place,
    PlaceKind,
    note_missing,
    read_attachment,
)
from robotctl.recording.identity import LIBRARY, RECOVERY_RECORD
from robotctl.recording.indexing import index_of
from robotctl.recording.mcap_file import McapFile
from robotctl.recording.mcap_input import MESSAGE_FIELDS, Damaged, InputFile, walk_records
from robotctl.recording.new_file import new_file
from robotctl.recording.options import Compression
from robotctl.recording.storage import DiskFile, Storage

Progress = Callable[[int, int], None]
"""Is told bytes done and bytes in total."""


@dataclass(frozen=True, slots=True)
class Salvage:
    """What came out of a recovery; `lost` says in sentences what did not."""

    target: Path
    message_count: int
    attachment_count: int
    lost: tuple[str, ...]


def recover(
    source: Path,
    target: Path,
    *,
    on_progress: Progress = lambda done, total: None,
    open_file: Callable[[Path], Storage] = DiskFile,
) -> Salvage:
    """Write all that can be read of the file `source` into the new file `target`.

    Raises UnreadableFile if nothing can be read, Refused if `target` exists or cannot be
    written. After an error there is no `target` but one that was there before.
    """
    try:
        file = InputFile(source)
    except (OSError, ValueError) as error:
        raise UnreadableFile(f"{source} cannot be read: {_reason(error)}") from error
    with file:
        total = 2 * file.size  # once to find what there is, once to copy it
        try:
            index = index_of(file, lambda done: on_progress(done, total))
        except Damaged as damage:
            raise UnreadableFile(f"{source} cannot be read: {damage}") from damage
        copy = _Copy(file, index, lambda done: on_progress(file.size + done, total))
        with new_file(target, open_file) as storage:
            copy.run(storage)
            if not copy.message_count and copy.lost:
                raise UnreadableFile(f"{source} holds no readable message: {'; '.join(copy.lost)}")
    on_progress(total, total)
    return Salvage(target, copy.message_count, copy.attachment_count, tuple(copy.lost))


class _Copy:
    """Copies the readable messages of one file, in file order."""

    def __init__(
        self, file: InputFile, index: FileIndex, on_progress: Callable[[int], None]
    ) -> None:
        self._file = file
        self._index = index
        self._on_progress = on_progress
        self.lost = list(index.missing)
        self.message_count = 0
        self.attachment_count = 0

    def run(self, storage: Storage) -> None:
        """Write the copy. Raises OSError."""
        index = self._index
        library = f"{LIBRARY}, recovered from {index.library}"
        mcap = McapFile(storage, profile=index.profile, library=library)
        for schema in index.schemas.values():
            if schema.id:  # 0 stands for no schema
                mcap.add_schema(schema)
        for channel in index.channels.values():
            known = channel.schema_id in index.schemas
            mcap.add_channel(channel if known else replace(channel, schema_id=0))
        encoder = ChunkEncoder(Compression.ZSTD, 1)
        for place in index.places:
            messages = self._read(place)
            if messages:
                mcap.commit(encoder.encode(pack(messages)), finished=False)
                self.message_count += len(messages)
            self._on_progress(place.offset)
        self._copy_attachments(mcap)
        for record in index.metadata:
            mcap.add_metadata(record.name, record.metadata)
        mcap.add_metadata(RECOVERY_RECORD, {"lost": "\n".join(self.lost)})
        mcap.commit()
        mcap.sync()

    def _copy_attachments(self, mcap: McapFile) -> None:
        for offset in self._index.attachments:
            try:
                mcap.add_attachment(read_attachment(self._file, offset))
            except Damaged as damage:
                note_missing(self.lost, f"the attachment at byte {offset} is lost: {damage}")
            else:
                mcap.commit(finished=False)  # one at a time in memory
                self.attachment_count += 1

    def _read(self, place: Place) -> list[PlainMessage]:
        messages: list[PlainMessage] = []
        try:
            for message in plain_messages(place.read(self._file)):
                if message[0] in self._index.channels:
                    messages.append(message)  # noqa: PERF401  # damage may end the loop
        except Damaged as damage:
            if place.kind is not PlaceKind.TORN_CHUNK:  # that was said before
                end = place.offset + place.length
                note_missing(self.lost, f"bytes {place.offset} to {end} are lost: {damage}")
        return messages


def plain_messages(data: bytes) -> Iterator[PlainMessage]:
    """The messages among these records. Raises Damaged at a tear, behind those before it."""
    for opcode, start, end in walk_records(data):
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = MESSAGE_FIELDS.unpack_from(data, start)
            yield channel, data[start + MESSAGE_FIELDS.size : end], log_ns, publish_ns, sequence


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
