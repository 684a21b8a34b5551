"""Finds the recordings below a folder that robotctl wrote, so that no others are changed."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from robotctl.recording.disk.access import open_private, share_like
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.format.names import OWN_LIBRARY
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import read_header
from robotctl.recording.read.mcap_input import InputFile

KEEP_FILE = "keep"
"""A recording with a file of this name in its folder is never removed."""

CLIPS_FOLDER = "clips"
"""Folder in a recording's folder. It is not part of the bag, but kept or removed with it."""


@dataclass(frozen=True, slots=True)
class CatalogFile:
    """A file of a recording; `modified_s` in seconds since the epoch."""

    path: Path
    size: int
    modified_s: float
    live: bool
    """Whether a running process is writing it."""


@dataclass(frozen=True, slots=True)
class CatalogFolder:
    """A recording of robotctl: `files` in their order, and the clips cut from it."""

    path: Path
    files: tuple[CatalogFile, ...]
    clips: tuple[CatalogFile, ...]
    kept: bool

    @property
    def live(self) -> bool:
        """Whether a running process is recording into it."""
        return any(file.live for file in self.files)


def own_recordings(recordings: Path) -> Iterator[CatalogFolder]:
    """Yield the recordings directly below `recordings`, ordered by name.

    Symbolic links are not followed. Folders that cannot be read are skipped.

    Raises:
        OSError: `recordings` itself cannot be listed.
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
    """Protect the recording in `folder` from removal, or end that.

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
    """Return whether the header of a file says that robotctl wrote it.

    Raises:
        OSError: It cannot be opened.
    """
    try:
        with InputFile(path) as file:
            header, _ = read_header(file)
    except Damaged:
        return False
    return header.library.startswith(OWN_LIBRARY)
