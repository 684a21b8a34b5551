"""Remove the oldest files of robotctl's recordings, and note each removal."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Final, NamedTuple

from robotctl.base.files import open_folder, open_regular
from robotctl.kernel.constants import DAY_S
from robotctl.recording.format.disk import open_private, replaced_file
from robotctl.recording.format.names import derived_files
from robotctl.recording.format.rosbag2 import METADATA_FILE, BagFile, write_metadata
from robotctl.recording.format.topics import Topic
from robotctl.recording.keep.listing import CLIPS_FOLDER, CatalogFile, CatalogFolder, own_recordings
from robotctl.recording.read.file_index import FileIndex, topic_of
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import InputFile


def rewrite_metadata(folder: Path, files: Sequence[Path]) -> None:
    """Write the `metadata.yaml` of `folder` for `files` in this order, leaving out damaged ones.

    Raises:
        OSError: `metadata.yaml` cannot be written, or a file cannot be opened.
    """
    topics: dict[Topic, int] = {}
    described = []
    for path in files:
        with suppress(Damaged), InputFile(path) as file:
            described.append(_describe(path.name, index_of(file), topics))
    write_metadata(folder, topics, described)


def _describe(name: str, index: FileIndex, topics: dict[Topic, int]) -> BagFile:
    counts: dict[int, int] = {}
    for channel in index.channels.values():
        schema = index.schemas.get(channel.schema_id)
        topic = topic_of(channel, schema.name if schema else "")
        position = topics.setdefault(topic, len(topics))
        counts[position] = counts.get(position, 0) + index.counts.get(channel.id, 0)
    return BagFile(name, index.start_ns, index.end_ns, counts)


class TidyNote(NamedTuple):
    """One action of tidying a recordings folder, or a failure."""

    text: str
    problem: bool = False
    """Whether data is lost, or a user must do something."""

    removed: str = ""
    """The path of a removed file, or ""."""


NOTES_FILE: Final = ".removed.jsonl"
"""The list of unreported removals in a recordings folder."""

_MAX_BYTES: Final = 4 << 20
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK


def note_removal(recordings: Path, path: Path, text: str) -> None:
    """Note that `path` will be removed, with the reason `text`.

    Raises:
        OSError: The note cannot be written.
    """
    with only_one_in(recordings):
        descriptor = open_private(recordings / NOTES_FILE, _APPEND)
        try:
            os.write(descriptor, json.dumps([str(path), text]).encode() + b"\n")
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def withdraw_note(recordings: Path, path: Path) -> None:
    """Delete the note by `note_removal`, as `path` was not removed after all.

    Raises:
        OSError: The notes cannot be written.
    """
    with only_one_in(recordings):
        notes = dict(_notes(recordings / NOTES_FILE))
        if notes.pop(str(path), None) is not None:
            _write(recordings / NOTES_FILE, notes)


def noted_removals(recordings: Path) -> Iterator[TidyNote]:
    """Yield and delete each note on a file that is gone. Requires the lock `only_one_in`."""
    path = recordings / NOTES_FILE
    notes = dict(_notes(path))
    if not notes:
        return
    for removed, text in notes.items():
        if not os.path.lexists(removed):
            yield TidyNote(f"{text}: {removed}", removed=removed)
    # The removal of a file that exists is in progress, or was interrupted.
    still = {removed: text for removed, text in notes.items() if os.path.lexists(removed)}
    with suppress(OSError):
        _write(path, still)


@contextmanager
def only_one_in(recordings: Path) -> Iterator[None]:
    """Wait for the lock of the folder `recordings`, and keep it during the block.

    Raises:
        OSError: The folder cannot be opened.
    """
    with open_folder(recordings) as folder:
        with suppress(OSError):  # NFS cannot lock a read-only descriptor
            flock(folder, LOCK_EX)
        yield


def _write(path: Path, notes: dict[str, str]) -> None:
    if not notes:
        path.unlink()
        return
    with replaced_file(path) as file:
        file.writelines(json.dumps(note).encode() + b"\n" for note in notes.items())


def _notes(path: Path) -> Iterator[tuple[str, str]]:
    try:
        with open_regular(path) as file:
            lines = file.read(_MAX_BYTES).splitlines()
    except OSError:
        return
    for line in lines:
        with suppress(ValueError, TypeError, RecursionError):  # torn, or of another program
            removed, text = json.loads(line)
            yield str(removed), str(text)


@dataclass(frozen=True, slots=True)
class RetentionPolicy:
    """The limits of a recordings folder in size and age. None means no limit."""

    max_bytes: int | None = 20_000_000_000
    max_age_s: float | None = 30 * DAY_S


def enforce_retention(
    recordings: Path,
    policy: RetentionPolicy,
    now_s: float,
    may_remove: Callable[[CatalogFile, CatalogFolder], bool] = lambda file, folder: True,
    on_failure: Callable[[CatalogFile, OSError], None] = lambda file, error: None,
) -> list[CatalogFile]:
    """Remove the oldest files below `recordings` until `policy` is met, and return them.

    Files being written, kept recordings and files of other programs are never removed. `may_remove`
    is called before each removal and may prevent it. `now_s` is since the epoch. Blocks.

    Raises:
        OSError: `recordings` cannot be listed.
    """
    folders = list(own_recordings(recordings))
    files = [(file, folder) for folder in folders for file in (*folder.files, *folder.clips)]
    files.sort(key=lambda pair: (pair[0].modified_s, pair[0].path))
    total = sum(file.size for file, _ in files)
    removed: list[CatalogFile] = []
    gone: set[Path] = set()
    for file, folder in files:
        too_much = policy.max_bytes is not None and total > policy.max_bytes
        too_old = policy.max_age_s is not None and now_s - file.modified_s > policy.max_age_s
        if file.live or folder.kept or not (too_much or too_old):
            continue
        if not may_remove(file, folder):
            continue
        try:
            file.path.unlink()
        except FileNotFoundError as error:  # another daemon has removed it
            on_failure(file, error)
        except OSError as error:  # it belongs to another user
            on_failure(file, error)
            continue
        else:
            removed.append(file)
        gone.add(file.path)
        total -= file.size
        with suppress(OSError):  # at once: this process may be killed before the next removal
            _tidy(folder, gone)
    return removed


def remove_recording(folder: CatalogFolder) -> list[CatalogFile]:
    """Remove and return all files and clips of a recording that is neither live nor kept. Blocks.

    Raises:
        OSError: A file cannot be removed; the files before it are removed.
    """
    removed: list[CatalogFile] = []
    try:
        for file in (*folder.clips, *folder.files):
            file.path.unlink(missing_ok=True)
            removed.append(file)
    finally:
        with suppress(OSError):
            _tidy(folder, {each.path for each in removed})
    return removed


def _tidy(folder: CatalogFolder, gone: set[Path]) -> None:
    """Update `metadata.yaml` after a removal, or remove the folder if no file is left."""
    if folder.live:
        return  # its writer updates metadata.yaml
    left = [file.path for file in folder.files if file.path not in gone]
    if left:
        if len(left) < len(folder.files):
            rewrite_metadata(folder.path, left)
        return
    for path in (folder.path / METADATA_FILE, *derived_files(folder.path)):
        path.unlink(missing_ok=True)
    with suppress(OSError):  # there is none, or it is not empty
        (folder.path / CLIPS_FOLDER).rmdir()
    folder.path.rmdir()
