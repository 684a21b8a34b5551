"""Recover the readable part of a broken file of any program into a new file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree

from mcap.opcode import Opcode

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.recording.format.disk import (
    DiskFile,
    Storage,
    is_shared,
    make_folder,
    new_file,
    share_like,
)
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
from robotctl.recording.read.files import (
    SUFFIX,
    Progress,
    absent_files,
    each_with_progress,
    recording_files,
)
from robotctl.recording.read.messages import ReadableFile, open_readable
from robotctl.recording.read.read_limits import Damaged, Unreadable
from robotctl.recording.read.records import InputFile
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile


def seal_of_repair(written: WrittenFile) -> Iterator[bytes]:
    """Yield the seal records that a repair adds: newest link, REPAIRED mark; none if unsealed."""
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
    """Yield the seal records for a copy of `file`: opening, REPAIRED mark; none if unsealed."""
    opening: Opening | None = None
    newest = Link(LinkKind.REPAIRED, number=1, covered=0, time_ns=0, digest=NO_DIGEST)
    offset = len(MAGIC)
    with suppress(Damaged):  # up to the first damage
        for _ in range(file.limits.records):
            record = file.record(offset)
            offset = record.end
            if record.opcode == Opcode.FOOTER:
                break
            is_seal = record.opcode in (OPENING_OPCODE, LINK_OPCODE)
            if not is_seal or record.length > MAX_OPENING_BYTES:
                continue
            with suppress(ValueError):  # not written by robotctl
                if record.opcode == LINK_OPCODE:
                    newest = Link.read(file.content(record))
                elif opening is None:
                    opening = Opening.read(file.content(record))
    if opening is None:
        return
    yield opening.record()
    yield Link(LinkKind.REPAIRED, newest.number, 0, time.time_ns(), newest.digest).record()


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """The result of a recovery. `lost` has a sentence per part that was not recovered.

    Higher read limits recover more if `limit_reached`. `failure` is an error of disk or memory.
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
    """Write the readable part of the file `source` into the new file `target`.

    Raises:
        UnreadableFile: Nothing can be read. No new file remains.
        Refused: `target` exists or cannot be written. No new file remains.
    """
    with ExitStack() as stack:
        try:
            file = stack.enter_context(open_readable(source, metadata_text(source), on_progress))
        except (OSError, ValueError, Damaged) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            raise UnreadableFile(f"{source} cannot be read: {reason or error}") from error
        with new_file(target, open_file) as storage:
            messages, attachments = _copy(file, storage)
            share_like(target, source)
            if not messages and file.lost:
                raise UnreadableFile(f"{source} holds no readable message: {'; '.join(file.lost)}")
    total = 2 * file.file.size
    on_progress(total, total)
    limited, failure = file.index.limit_reached, file.file.failure
    return RecoveryReport(target, messages, attachments, tuple(file.lost), limited, failure)


def _copy(file: ReadableFile, storage: Storage) -> tuple[int, int]:
    """Copy the readable part of `file`; return the numbers of messages and attachments.

    Raises:
        OSError: The disk is full or fails.
    """
    library = f"{LIBRARY}, recovered from {file.library}"
    mcap = McapFile(storage, profile=file.profile, library=library)
    message_count = attachment_count = 0
    for sealed in seal_of_copy(file.file):
        mcap.add_sealed(sealed)
    for schema in file.index.schemas.values():
        if schema.id:  # 0 means no schema
            mcap.add_schema(schema)
    for channel, described_by in file.channels():
        mcap.add_channel(channel if described_by is not None else replace(channel, schema_id=0))
    encoder = ChunkEncoder(Compression.ZSTD, 1)
    for messages in file.batches():
        mcap.commit(encoder.encode(pack(messages)), finished=False)
        message_count += len(messages)
    for attachment in file.attachments():
        mcap.add_attachment(attachment)
        mcap.commit(finished=False)  # one at a time in memory
        attachment_count += 1
    for record in file.metadata():
        values = record.metadata
        if record.name == METADATA_RECORD:
            values = without_compression(values)
        mcap.add_metadata(record.name, values)
    mcap.add_metadata(RECOVERY_RECORD, {"lost": "\n".join(file.lost)})
    mcap.commit()
    mcap.sync()
    return message_count, attachment_count


def recover_folder(
    source: Path, target: Path, *, on_progress: Progress = lambda done, total: None
) -> RecoveryReport:
    """Write the readable part of the recording `source` into the new folder `target`.

    Raises:
        UnreadableFile: Nothing can be read. No new folder remains.
        Refused: `target` exists or cannot be written. No new folder remains.
    """
    text = metadata_text(source)
    paths = recording_files(source)
    try:
        make_folder(target, shared=is_shared(source))
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror}") from error
    lost = absent_files(text, paths)
    saved: list[RecoveryReport] = []
    try:
        for path, tell in each_with_progress(paths, on_progress):
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
        target, count, sum(report.attachment_count for report in saved), tuple(lost)
    )
