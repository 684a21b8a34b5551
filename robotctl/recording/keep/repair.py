"""Remove old files from a recordings folder, and repair files that were not closed."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import msgspec
from isal.isal_zlib import crc32
from mcap.opcode import Opcode

from robotctl.base.errors import RobotctlError
from robotctl.base.processes import Report
from robotctl.recording.format.disk import DiskFile, reason_of
from robotctl.recording.format.names import LEDGER_RECORD, RECOVERY_RECORD, Compression
from robotctl.recording.format.records import PlainMessage
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.format.trailer import WrittenFile
from robotctl.recording.keep.listing import CatalogFolder, own_recordings
from robotctl.recording.keep.recover import recover, seal_of_repair
from robotctl.recording.keep.retention import (
    RetentionPolicy,
    TidyNote,
    enforce_retention,
    noted_removals,
    only_one_in,
    rewrite_metadata,
)
from robotctl.recording.read.chunks import read_chunk, read_chunk_head
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.indexing import (
    find_unfinished_commit,
    index_from_summary,
    read_written_file,
)
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import MESSAGE_FIELDS, InputFile, walk_records
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile


def messages_of_chunk(file: InputFile, offset: int) -> list[PlainMessage]:
    """Return the messages of the chunk at `offset`, [] without a complete chunk there."""
    try:
        head = read_chunk_head(file, offset, file.record(offset).end - offset)
        data, found = read_chunk(file, head), list[PlainMessage]()
        for opcode, start, end in walk_records(data):
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_ns, publish_ns = MESSAGE_FIELDS.unpack_from(data, start)
                content = data[start + MESSAGE_FIELDS.size : end]
                found.append((channel, content, log_ns, publish_ns, sequence))
    except Damaged:
        return []
    return found


_UNFINISHED = ".repair"


def repair(recordings: Path) -> Iterator[TidyNote]:
    """Repair the files below `recordings` that were not closed, and yield a note of each.

    Blocks. Recordings that a process is writing are skipped. A torn file is replaced by its
    readable part.

    Raises:
        OSError: `recordings` cannot be listed.
    """
    for folder in own_recordings(recordings):
        if not folder.live:
            try:
                yield from _repair_folder(folder)
            except Exception as error:  # noqa: BLE001 - continue with the other folders
                yield _failed(str(folder.path), error)


def _repair_folder(folder: CatalogFolder) -> Iterator[TidyNote]:
    _remove_leftovers(folder.path)
    changed = _list_is_older(folder)
    try:
        for file in folder.files:
            try:
                tidied = _repair_file(file.path)
            except Exception as error:  # noqa: BLE001 - continue with the other files
                yield _failed(file.path.name, error)
                continue
            if tidied:
                changed = True
                yield tidied
    finally:
        if changed:
            rewrite_metadata(folder.path, [file.path for file in folder.files])


def _list_is_older(folder: CatalogFolder) -> bool:
    """Return whether a repair was killed before it could update `metadata.yaml`."""
    with suppress(FileNotFoundError):
        listed_ns = (folder.path / METADATA_FILE).stat().st_mtime_ns
        for path in (each.path for each in folder.files):
            if path.stat().st_mtime_ns > listed_ns:
                with suppress(Damaged), InputFile(path) as file:
                    if index_from_summary(file, places=False).has_metadata(RECOVERY_RECORD):
                        return True
    return False


def _remove_leftovers(folder: Path) -> None:
    """Remove the unfinished files of an interrupted repair.

    Raises:
        OSError: A file cannot be removed.
    """
    name = re.compile(re.escape(folder.name) + r"_\d+\.mcap" + re.escape(_UNFINISHED))
    for path in folder.iterdir():
        if name.fullmatch(path.name) and path.is_file() and not path.is_symlink():
            path.unlink()


def _repair_file(path: Path) -> TidyNote | None:
    """Repair the file and return a note, None if it was closed or repaired before.

    Raises:
        OSError, Damaged, MemoryError: The file is unchanged.
    """
    with InputFile(path) as file:
        try:
            if index_from_summary(file, places=False).has_metadata(LEDGER_RECORD, RECOVERY_RECORD):
                return None
            index = index_from_summary(file)
            if index.limit_reached:
                missing = "; ".join(index.missing)
                text = f"{path.name} was not closed and is left as it is: {missing}"
                return TidyNote(text, problem=True)
            _verify(file, index)
            written = read_written_file(file)
            unfinished = find_unfinished_commit(file, index, written.data_end)
        except Damaged:
            if file.failure:
                raise file.failure from None
            return _replace(path)
        messages = [] if unfinished is None else messages_of_chunk(file, unfinished)
        data_end = written.data_end if unfinished is None else unfinished
        data_crc = reduce(lambda crc, piece: crc32(piece, crc), file.pieces(0, data_end), 0)
        written = replace(written, data_end=data_end, data_crc=data_crc)
        old_end = file.read(data_end, file.size - data_end)
        if file.failure:  # otherwise an unreadable chunk would be cut off
            raise file.failure
    _close(path, written, messages, old_end)
    count = index.message_count + len(messages)
    return TidyNote(f"repaired: {path.name} was not closed: its {count} messages are complete")


def _close(
    path: Path, written: WrittenFile, messages: Sequence[PlainMessage], old_end: bytes
) -> None:
    """Write `messages` and a trailer behind the data, or restore `old_end` after an error.

    Raises:
        OSError: The disk is full or fails.
    """
    storage = DiskFile(path, new=False)
    try:
        mcap = McapFile.resume(storage, written)
        for record in seal_of_repair(written):
            mcap.add_sealed(record)
        mcap.add_metadata(RECOVERY_RECORD, {"lost": ""})
        mcap.commit(ChunkEncoder(Compression.ZSTD, 1).encode(pack(messages)) if messages else None)
        storage.truncate(mcap.size)
        mcap.sync()
    except BaseException:  # the disk is full, or there is no memory
        storage.write_at([old_end], written.data_end)
        storage.truncate(written.data_end + len(old_end))
        raise
    finally:
        storage.close()


def _verify(file: InputFile, index: FileIndex) -> None:
    """Read all messages once.

    Raises:
        Damaged: A message cannot be read.
    """
    left = file.limits.records
    for place in index.places:
        left -= sum(1 for _ in walk_records(place.read(file), left))


def _replace(path: Path) -> TidyNote:
    """Replace the file by its readable part.

    Raises:
        OSError: The disk is full or fails.
        Unreadable: The disk or the memory failed while reading.
    """
    repaired = path.with_name(path.name + _UNFINISHED)
    try:
        report = recover(path, repaired)
    except RobotctlError as error:
        return TidyNote(f"{path.name} was torn and cannot be repaired: {error}", problem=True)
    if report.failure:
        repaired.unlink()
        raise report.failure
    if report.limit_reached:
        repaired.unlink()
        text = f"{path.name} was torn and is left as it is: {'; '.join(report.lost)}"
        return TidyNote(text, problem=True)
    repaired.replace(path)
    lost = "; ".join(report.lost)
    text = (
        f"repaired: {path.name} was torn: {report.message_count} messages were recovered ({lost})"
    )
    return TidyNote(text, problem=True)


def _failed(name: str, error: Exception) -> TidyNote:
    reason = error if isinstance(error, Damaged) else reason_of(error)
    text = f"{name} could not be repaired: {reason} (the next start tries again)"
    return TidyNote(text, problem=True)


@dataclass(frozen=True, slots=True)
class TidyJob:
    """The parameters of `tidy`. `repairs` switches the repair on."""

    recordings: Path
    policy: RetentionPolicy
    repairs: bool


def tidy(job: TidyJob) -> Iterator[TidyNote]:
    """Tidy a recordings folder, and yield a note of each removal, repair and failure.

    Blocks, also while another process tidies the folder. Files being written are unchanged.
    """
    recordings = job.recordings
    try:
        with only_one_in(recordings):
            yield from noted_removals(recordings)
            for removed in enforce_retention(recordings, job.policy, time.time()):
                text = f"removed for its age or to free space: {removed.path}"
                yield TidyNote(text, removed=str(removed.path))
            if job.repairs:
                yield from repair(recordings)
    except Exception as error:  # noqa: BLE001 - files of any origin
        text = f"{recordings} could not be tidied: {type(error).__name__}: {error}"
        yield TidyNote(text, problem=True)


def tidy_job(given: dict[str, Any], report: Report) -> None:
    """Run `tidy` for the TidyJob in `given`, and report each note. Called in a new process."""
    for note in tidy(msgspec.convert(given, TidyJob, dec_hook=lambda kind, value: kind(value))):
        report(note._asdict())
