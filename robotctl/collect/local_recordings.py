"""Finds what is to be collected: every recording in a folder, also a damaged or a foreign one.

What is removed must be robotctl's own for certain; what is copied need not be. A file that cannot
be copied is named: nothing is left out in silence.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Final

from robotctl.collect.local_files import open_collected
from robotctl.collect.object_names import is_plain
from robotctl.errors import UnreadableFile
from robotctl.kernel.units import NS_PER_S
from robotctl.printable import printable
from robotctl.recording.disk.disk_errors import reason_of
from robotctl.recording.disk.storage import is_locked
from robotctl.recording.format.derived_files import INDEX_FILE
from robotctl.recording.format.natural_order import natural_order
from robotctl.recording.format.records import MAGIC
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.keep.catalog import CLIPS_FOLDER, is_own

SUFFIX: Final = ".mcap"

YOUNG_NS: Final = 60 * NS_PER_S
"""Another recorder holds no lock: a file of it without an end is finished after so long a rest."""

OF_THE_SYSTEM: Final = "lost+found"
"""For root alone on each disk, and no recording."""

_RENAME: Final = "rename it: letters, digits and _ . + = @ - only"


@dataclass(slots=True)
class LocalRecording:
    """A recording to collect: a folder with files of data, or a single file.

    Names of files are those in the store. `left_out` has a sentence for each file that cannot be
    collected.
    """

    name: str
    files: dict[str, Path] = field(default_factory=dict)
    size_bytes: int = 0
    live: bool = False
    """Whether a running process is recording into it."""

    left_out: list[str] = field(default_factory=list)


def local_recordings(folder: Path, now_ns: int) -> list[LocalRecording]:
    """Return the recordings directly below `folder`, ordered by name.

    A single file becomes a recording of its name, without `.mcap`. Links are not followed.
    `now_ns` is since the epoch.

    Raises:
        OSError: `folder` cannot be listed.
    """
    found = [_recording(path, now_ns) for path in sorted(folder.iterdir())]
    return [each for each in found if each.files or each.live or each.left_out]


def _recording(path: Path, now_ns: int) -> LocalRecording:
    recording = LocalRecording(path.name)
    try:
        if path.is_symlink():
            _link(recording, path)
        elif path.is_dir():
            _folder(recording, path, now_ns)
        elif path.name.endswith(SUFFIX):
            recording.name = path.name.removesuffix(SUFFIX)
            if path.with_name(recording.name).is_dir():
                _leave_out(recording, path.name, "a folder has its name: rename one of them")
            else:
                _add_data(recording, path, path.name, now_ns)
    except OSError as error:
        if path.name != OF_THE_SYSTEM and not path.name.startswith("."):
            recording.left_out.append(f"it cannot be listed: {reason_of(error)}")
    if not is_plain(recording.name) and (recording.files or recording.live):
        return LocalRecording(recording.name, left_out=[f"it is left out: {_RENAME}"])
    return recording


def _link(recording: LocalRecording, path: Path) -> None:
    """Name a link to recordings that are elsewhere; one to its neighbour is no other recording."""
    target = path.resolve()
    if target.is_relative_to(path.parent.resolve()):
        return
    if path.name.endswith(SUFFIX) or (target.is_dir() and any(target.glob(f"*{SUFFIX}"))):
        recording.left_out.append("it is left out: it is a link")


def _folder(recording: LocalRecording, folder: Path, now_ns: int) -> None:
    for path in _data_in(folder):
        _add_data(recording, path, path.name, now_ns)
    is_live = recording.live
    clips = folder / CLIPS_FOLDER
    if clips.is_dir() and not clips.is_symlink():
        for path in _data_in(clips):
            _add_data(recording, path, f"{CLIPS_FOLDER}/{path.name}", now_ns)
    if not is_live and (recording.files or recording.left_out):
        for path in (folder / METADATA_FILE, folder / INDEX_FILE):
            if path.is_symlink():
                _leave_out(recording, path.name, "it is a link")
            elif path.is_file():
                recording.files[path.name] = path


def _data_in(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        found = [Path(each.path) for each in entries if each.name.endswith(SUFFIX)]
    yield from sorted(found, key=natural_order)


def _add_data(recording: LocalRecording, path: Path, name: str, now_ns: int) -> None:
    """Add a file, unless it is being written; name it if it cannot be collected."""
    if path.is_symlink():
        _leave_out(recording, name, "it is a link")
    elif not is_plain(name):
        _leave_out(recording, name, _RENAME)
    else:
        try:
            with open_collected(path) as file:
                status = os.fstat(file.fileno())
                if _is_live(path, file, status, now_ns):
                    recording.live = True
                    return
        except UnreadableFile as error:
            recording.left_out.append(str(error))
        else:
            recording.files[name] = path
            recording.size_bytes += status.st_size


def _is_live(path: Path, file: FileIO, status: os.stat_result, now_ns: int) -> bool:
    """Return whether a process is writing a file: one of robotctl locks it."""
    try:
        if is_locked(file.fileno()):
            return True
        if is_own(path):
            return False
    except OSError:  # a file system without locks
        pass
    return now_ns - status.st_mtime_ns < YOUNG_NS and not _has_end(file, status.st_size)


def _has_end(file: FileIO, size: int) -> bool:
    return os.pread(file.fileno(), len(MAGIC), max(size - len(MAGIC), 0)) == MAGIC


def _leave_out(recording: LocalRecording, name: str, why: str) -> None:
    recording.left_out.append(f"{printable(name)} is left out: {why}")
