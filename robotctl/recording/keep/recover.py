"""Recovers what a broken file of any writer still holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.recording.disk.access import share_like
from robotctl.recording.disk.storage import DiskFile, Storage, new_file
from robotctl.recording.format.names import LIBRARY, RECOVERY_RECORD, Compression
from robotctl.recording.format.rosbag2 import METADATA_RECORD, metadata_text
from robotctl.recording.keep.repaired_seal import seal_of_copy
from robotctl.recording.read.compressed_messages import without_compression
from robotctl.recording.read.count_check import find_shortfalls
from robotctl.recording.read.damage import Damaged, Unreadable
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.messages import OpenFile
from robotctl.recording.read.readable_file import ReadableFile
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile

Progress = Callable[[int, int], None]
"""Gets bytes done, and in total."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What was recovered; `lost` says in sentences what was not.

    `limit_reached` tells that more can be read with higher limits. `failure` is not None if the
    disk or the memory failed while reading: a later attempt may recover more.
    """

    target: Path
    message_count: int
    attachment_count: int
    lost: tuple[str, ...]
    limit_reached: bool = False
    failure: Unreadable | None = None


def recover(
    source: Path,
    target: Path,
    *,
    on_progress: Progress = lambda done, total: None,
    open_file: Callable[[Path], Storage] = DiskFile,
) -> RecoveryReport:
    """Write all that can be read of the file `source` into the new file `target`.

    Raises:
        UnreadableFile: Nothing can be read.
        Refused: `target` exists or cannot be written.

    After an error no new file remains.
    """
    try:
        file = InputFile(source, on_progress)
    except (OSError, ValueError, Damaged) as error:
        raise UnreadableFile(f"{source} cannot be read: {_reason(error)}") from error
    text = metadata_text(source)
    with file:
        total = 2 * file.size  # one pass to index, one to copy
        try:
            index = index_of(file, lambda done: on_progress(done, total))
        except Damaged as damage:
            raise UnreadableFile(f"{source} cannot be read: {damage}") from damage
        for sentence in find_shortfalls(text, [OpenFile(source, file, index)], all_files=False):
            index.miss(sentence)
        copy = _RecoveryWriter(file, index, lambda done: on_progress(file.size + done, total))
        with new_file(target, open_file) as storage:
            copy.run(storage)
            share_like(target, source)
            if not copy.message_count and copy.lost:
                raise UnreadableFile(f"{source} holds no readable message: {'; '.join(copy.lost)}")
    on_progress(total, total)
    return RecoveryReport(
        target,
        copy.message_count,
        copy.attachment_count,
        tuple(copy.lost),
        index.limit_reached,
        file.failure,
    )


class _RecoveryWriter:
    """Copies the readable messages of one file, in file order."""

    def __init__(
        self, file: InputFile, index: FileIndex, on_progress: Callable[[int], None]
    ) -> None:
        self._file = file
        self._index = index
        self._source = ReadableFile(file, index, on_progress)
        self.lost = self._source.lost
        self.message_count = 0
        self.attachment_count = 0

    def run(self, storage: Storage) -> None:
        """Write the copy.

        Raises:
            OSError: The disk is full or fails.
        """
        index = self._index
        library = f"{LIBRARY}, recovered from {index.library}"
        mcap = McapFile(storage, profile=index.profile, library=library)
        for sealed in seal_of_copy(self._file):
            mcap.add_sealed(sealed)
        for schema in index.schemas.values():
            if schema.id:  # 0 means no schema
                mcap.add_schema(schema)
        for channel in index.channels.values():
            known = channel.schema_id in index.schemas
            mcap.add_channel(channel if known else replace(channel, schema_id=0))
        encoder = ChunkEncoder(Compression.ZSTD, 1)
        for messages in self._source.batches():
            mcap.commit(encoder.encode(pack(messages)), finished=False)
            self.message_count += len(messages)
        for attachment in self._source.attachments():
            mcap.add_attachment(attachment)
            mcap.commit(finished=False)  # one at a time in memory
            self.attachment_count += 1
        for record in index.metadata:
            values = record.metadata
            if record.name == METADATA_RECORD:
                values = without_compression(values)
            mcap.add_metadata(record.name, values)
        mcap.add_metadata(RECOVERY_RECORD, {"lost": "\n".join(self.lost)})
        mcap.commit()
        mcap.sync()


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
