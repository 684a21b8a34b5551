"""Recovers what can be read of a broken file, whichever program wrote it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from shutil import rmtree

from mcap.opcode import Opcode

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.recording.disk.access import is_shared, make_folder, share_like
from robotctl.recording.disk.storage import DiskFile, Storage, new_file
from robotctl.recording.format.names import LIBRARY, RECOVERY_RECORD, Compression
from robotctl.recording.format.records import MAGIC, RECORD_HEAD_BYTES
from robotctl.recording.format.rosbag2 import METADATA_RECORD, metadata_text, total_count_in
from robotctl.recording.format.seal_records import (
    LINK_OPCODE,
    MAX_OPENING_BYTES,
    NO_DIGEST,
    OPENING_OPCODE,
    Link,
    LinkKind,
    Opening,
)
from robotctl.recording.format.trailer import WrittenFile
from robotctl.recording.keep.retention import rewrite_metadata
from robotctl.recording.read.chunks import without_compression
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.files import absent_files, recording_files
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.messages import OpenFile, ReadableFile, find_shortfalls
from robotctl.recording.read.read_limits import Damaged, Unreadable
from robotctl.recording.read.records import InputFile
from robotctl.recording.read.source import SUFFIX
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile


def seal_of_repair(written: WrittenFile) -> Iterator[bytes]:
    """Yield the records to add to a sealed file before a repair writes: its newest head, and an
    unsigned link of kind REPAIRED. Yield nothing for a file without a seal.
    """
    if not written.seal:
        return
    try:
        head = Link.read(written.seal[RECORD_HEAD_BYTES:])
    except ValueError:  # not written by robotctl
        return
    yield head.record()
    yield Link(
        LinkKind.REPAIRED, head.number, written.data_end, time.time_ns(), head.digest
    ).record()


def seal_of_copy(file: InputFile) -> Iterator[bytes]:
    """Yield the records to add to the copy of a sealed file: the opening of the original, and an
    unsigned link of kind REPAIRED, which covers no byte and has the newest digest that was read
    from the original. Yield nothing for a file without a seal.
    """
    opening: Opening | None = None
    newest = Link(LinkKind.REPAIRED, number=1, covered=0, time_ns=0, digest=NO_DIGEST)
    for opcode, content in _seal_records(file):
        with suppress(ValueError):  # not written by robotctl
            if opcode == LINK_OPCODE:
                newest = Link.read(content)
            elif opening is None:
                opening = Opening.read(content)
    if opening is None:
        return
    yield opening.record()
    yield Link(LinkKind.REPAIRED, newest.number, 0, time.time_ns(), newest.digest).record()


def _seal_records(file: InputFile) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record of a seal, up to the first damage."""
    offset = len(MAGIC)
    with suppress(Damaged):
        for _ in range(file.limits.records):
            record = file.record(offset)
            if record.opcode == Opcode.FOOTER:
                return
            is_seal = record.opcode in (OPENING_OPCODE, LINK_OPCODE)
            if is_seal and record.length <= MAX_OPENING_BYTES:
                yield record.opcode, file.content(record)
            offset = record.end


Progress = Callable[[int, int], None]
"""Called with the bytes done, and the bytes in total."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What was recovered; `lost` says in sentences what was not.

    `limit_reached` is True if more can be read with higher limits. `failure` is not None if the
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
    """Copies what can be read of one file: messages in file order, attachments, metadata."""

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
        library = f"{LIBRARY}, recovered from {index.header.library}"
        mcap = McapFile(storage, profile=index.header.profile, library=library)
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


def recover_folder(
    source: Path, target: Path, *, on_progress: Progress = lambda done, total: None
) -> RecoveryReport:
    """Write all that can be read of the recording `source` into the new folder `target`.

    Raises:
        UnreadableFile: Nothing can be read.
        Refused: `target` exists or cannot be written.

    After an error no new folder remains.
    """
    text = metadata_text(source)
    paths = recording_files(source)
    sizes = [2 * path.stat().st_size if path.exists() else 0 for path in paths]
    try:
        make_folder(target, shared=is_shared(source))
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror}") from error
    lost = absent_files(text, paths)
    saved: list[RecoveryReport] = []
    try:
        for path, before in zip(paths, accumulate(sizes[:-1], initial=0), strict=True):
            tell = partial(_tell, on_progress, before, sum(sizes))
            try:
                report = recover(path, target / path.name.removesuffix(SUFFIX), on_progress=tell)
            except UnreadableFile as error:
                lost.append(str(error))
            else:
                saved.append(report)
                lost += (f"{path.name}: {sentence}" for sentence in report.lost)
        told, count = total_count_in(text), sum(report.message_count for report in saved)
        if not lost and told > count:
            lost.append(f"metadata.yaml counts {told} messages, and {count} are there")
        if not saved:
            raise UnreadableFile("; ".join(lost))
        rewrite_metadata(target, [report.target for report in saved])
    except BaseException as error:
        with suppress(OSError):
            rmtree(target)
        if isinstance(error, OSError):
            raise Refused(f"cannot write {target}: {error.strerror}") from error
        raise
    return RecoveryReport(
        target,
        count,
        sum(report.attachment_count for report in saved),
        tuple(lost),
    )


def _tell(on_progress: Progress, before: int, total: int, done: int, _: int) -> None:
    on_progress(before + done, total)
