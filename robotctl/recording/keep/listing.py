"""List all recordings in a folder, or only those of robotctl."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from errno import ENOENT
from pathlib import Path

from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.disk import is_being_written, open_private, share_like
from robotctl.recording.format.names import INFO_RECORD, OWN_LIBRARY, EventKind
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.format.rosbag2 import metadata_text
from robotctl.recording.read.files import (
    files_of_bag,
    is_bag,
    is_zstd_file,
    may_not_be_listed,
    reason_of,
)
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.messages import OpenFile, find_shortfalls
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import InputFile, read_header

KEEP_FILE = "keep"
"""The name of a file that protects the recording in its folder from removal."""

CLIPS_FOLDER = "clips"
"""Subfolder for the clips of a recording, which are not part of the bag."""


@dataclass(frozen=True, slots=True)
class CatalogFile:
    """A file of a recording, last modified at `modified_s` [s since the epoch]."""

    path: Path
    size: int
    modified_s: float
    live: bool
    """Whether a running process is writing it."""


@dataclass(frozen=True, slots=True)
class CatalogFolder:
    """A recording of robotctl, with its files in order. Retention skips it if `kept`."""

    path: Path
    files: tuple[CatalogFile, ...]
    clips: tuple[CatalogFile, ...]
    kept: bool

    @property
    def live(self) -> bool:
        """Whether a running process is writing one of the files."""
        return any(file.live for file in self.files)


def own_recordings(recordings: Path) -> Iterator[CatalogFolder]:
    """Yield robotctl's readable recordings directly below `recordings` by name, without links.

    Raises:
        OSError: `recordings` cannot be listed.
    """
    for folder in sorted(recordings.iterdir()):
        with suppress(OSError):
            if own := own_recording(folder):
                yield own


def own_recording(folder: Path) -> CatalogFolder | None:
    """Return the recording in `folder`, None for a link or a folder without files of robotctl.

    Raises:
        OSError: `folder` cannot be read.
    """
    if folder.is_symlink() or not folder.is_dir():
        return None
    files, clips = tuple(_files(folder)), tuple(_clips(folder))
    if not (files or clips):
        return None
    return CatalogFolder(folder, files, clips, (folder / KEEP_FILE).exists())


def set_kept(folder: Path, kept: bool) -> None:
    """Protect the recording in `folder` from removal if `kept`, or else end the protection.

    Raises:
        OSError: The folder cannot be written.
    """
    if kept:
        os.close(open_private(folder / KEEP_FILE, os.O_WRONLY | os.O_CREAT))
        share_like(folder / KEEP_FILE, folder)
    else:
        (folder / KEEP_FILE).unlink(missing_ok=True)


def _files(folder: Path) -> Iterator[CatalogFile]:
    name = re.compile(re.escape(folder.name) + r"_(\d+)\.mcap")
    numbered = [(name.fullmatch(path.name), path) for path in folder.iterdir()]
    ours = sorted((int(match[1]), path) for match, path in numbered if match)
    yield from _own(path for _, path in ours)


def _clips(folder: Path) -> Iterator[CatalogFile]:
    clips = folder / CLIPS_FOLDER
    if clips.is_dir() and not clips.is_symlink():
        yield from _own(sorted(clips.glob("*.mcap")))


def _own(paths: Iterable[Path]) -> Iterator[CatalogFile]:
    for path in paths:
        if not path.is_symlink() and path.is_file() and is_own(path):
            stat = path.stat()
            yield CatalogFile(path, stat.st_size, stat.st_mtime, is_being_written(path))


def is_own(path: Path) -> bool:
    """Return whether robotctl wrote a file, by its header.

    Raises:
        OSError: The file cannot be opened.
    """
    try:
        with InputFile(path) as file:
            header, _ = read_header(file)
    except Damaged:
        return False
    return header.library.startswith(OWN_LIBRARY)


GRAVEST_FIRST = (EventKind.EMERGENCY_STOP, EventKind.ERROR)


@dataclass(frozen=True, slots=True)
class ListedRecording:
    """A recording in a folder or a single file. All times are since the epoch.

    `start_ns` and `end_ns` are 0 without messages. `damage` has a sentence per unreadable part.
    """

    path: Path
    robot: str
    start_ns: int
    end_ns: int
    modified_s: float
    size_bytes: int
    files: int
    clips: tuple[Path, ...]
    events: tuple[RecordedEvent, ...]
    readable: bool
    damage: tuple[str, ...]
    live: bool
    kept: bool

    @property
    def duration_s(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    @property
    def laps(self) -> int:
        """Completed laps of the ended drives."""
        return sum(event.laps for event in self.events)

    @property
    def driven_s(self) -> float | None:
        """Total duration of the ended drives [s], None if unknown."""
        known = [event.drive_s for event in self.events if event.drive_s is not None]
        return sum(known) if known else None

    def largest(self, error: str) -> float | None:
        """Return the largest value of a drive error, such as "closure_m", None if it is unknown."""
        known: list[float | None] = [getattr(event, error) for event in self.events]
        return max((each for each in known if each is not None), default=None)

    @property
    def worst(self) -> EventKind | None:
        """The gravest kind of event, None without an emergency stop or error."""
        kinds = {event.kind for event in self.events}
        return next((kind for kind in GRAVEST_FIRST if kind in kinds), None)


def list_recordings(
    folder: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[ListedRecording]:
    """Yield the recordings directly below `folder` by name, without links.

    Raises:
        OSError: `folder` cannot be listed.
    """
    found = recordings_in(folder)
    for done, path in enumerate(found):
        on_progress(done, len(found))
        with suppress(OSError):  # it was removed meanwhile
            yield list_recording(path)
    on_progress(len(found), len(found))


def recordings_in(folder: Path) -> list[Path]:
    """Return the recordings and unlistable folders in `folder` by name, without links.

    Raises:
        OSError: `folder` cannot be listed.
    """
    return [path for path in sorted(folder.iterdir()) if _is_listed(path)]


def _is_listed(path: Path) -> bool:
    if path.is_symlink() or not path.is_dir():
        return path.suffix == ".mcap" and path.is_file() and not path.is_symlink()
    return is_bag(path) and not (path.name.startswith(".") and may_not_be_listed(path))


def list_recording(path: Path) -> ListedRecording:
    """Return the description of the recording `path`, even if parts are damaged.

    Raises:
        OSError: `path` does not exist or holds no recording.
    """
    text = metadata_text(path)
    files: list[Path] = []
    damage: list[str] = []
    try:
        if path.is_dir():
            files = files_of_bag(path)
        elif path.is_file() and (path.suffix == ".mcap" or is_zstd_file(path)):
            files = [path]
    except PermissionError as error:
        damage.append(reason_of(error))
    if not (files or damage):
        raise FileNotFoundError(ENOENT, os.strerror(ENOENT), str(path))
    opened: list[OpenFile] = []
    live = False
    for each in files:
        prefix = "" if each == path else f"{each.name}: "
        try:
            with InputFile(each) as file:
                live = live or file.is_changing()
                opened.append(OpenFile(each, file, index_of(file, places=False)))
            damage += (prefix + sentence for sentence in opened[-1].index.missing)
        except (Damaged, OSError) as error:
            damage.append(f"{prefix}{error}")
    if opened:
        damage += find_shortfalls(text, opened, all_files=files != [path])
    indexes = [each.index for each in opened]
    with_messages = [index for index in indexes if index.message_count]
    metadata = [record for index in indexes for record in index.metadata]
    info = next((record.metadata for record in metadata if record.name == INFO_RECORD), {})
    stats = [each.stat() for each in files or [path]]
    is_open = bool(files) and path.is_dir()
    return ListedRecording(
        path=path,
        robot=info.get("robot", ""),
        start_ns=min((index.start_ns for index in with_messages), default=0),
        end_ns=max((index.end_ns for index in with_messages), default=0),
        modified_s=max(stat.st_mtime for stat in stats),
        size_bytes=sum(stat.st_size for stat in stats),
        files=len(files),
        clips=tuple(sorted((path / CLIPS_FOLDER).glob("*.mcap"))) if is_open else (),
        events=tuple(events_in(metadata)),
        readable=bool(indexes),
        damage=tuple(damage),
        live=live,
        kept=is_open and (path / KEEP_FILE).exists(),
    )
