"""Removes the oldest recordings of robotctl, so that the disk does not fill up."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from robotctl.kernel.units import DAY_S
from robotctl.recording.format.names import derived_files
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.keep.bag_metadata import rewrite_metadata
from robotctl.recording.keep.catalog import (
    CLIPS_FOLDER,
    CatalogFile,
    CatalogFolder,
    own_recordings,
)


@dataclass(frozen=True, slots=True)
class RetentionPolicy:
    """How much to keep: in total [bytes] and for how long [s]; None means no limit."""

    max_bytes: int | None = 20_000_000_000
    max_age_s: float | None = 30 * DAY_S


@dataclass(frozen=True, slots=True)
class Removed:
    """A file that retention removed."""

    path: Path
    size: int


def enforce_retention(
    recordings: Path,
    policy: RetentionPolicy,
    now_s: float,
    may_remove: Callable[[CatalogFile, CatalogFolder], bool] = lambda file, folder: True,
    on_failure: Callable[[CatalogFile, OSError], None] = lambda file, error: None,
) -> list[Removed]:
    """Remove files below `recordings`, the oldest first, until `policy` is met.

    Never removed: a file that is being written, a recording with a `keep` file and its clips, and
    files that robotctl did not record. `may_remove` is asked just before each removal, and
    `on_failure` told after one that failed. `now_s` is in seconds since the epoch. Blocks.

    Raises:
        OSError: `recordings` cannot be listed.
    """
    folders = list(own_recordings(recordings))
    files = [(file, folder) for folder in folders for file in (*folder.files, *folder.clips)]
    files.sort(key=lambda pair: (pair[0].modified_s, pair[0].path))
    total = sum(file.size for file, _ in files)
    removed: list[Removed] = []
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
            removed.append(Removed(file.path, file.size))
        gone.add(file.path)
        total -= file.size
        with suppress(OSError):  # at once: this process may be killed before the next removal
            _tidy(folder, gone)
    return removed


def remove_recording(folder: CatalogFolder) -> list[Removed]:
    """Remove the files and clips of a recording that is neither live nor kept. Blocks.

    The folder stays if it holds other files.

    Raises:
        OSError: A file cannot be removed; those before it are gone.
    """
    removed: list[Removed] = []
    try:
        for file in (*folder.clips, *folder.files):
            file.path.unlink(missing_ok=True)
            removed.append(Removed(file.path, file.size))
    finally:
        with suppress(OSError):
            _tidy(folder, {each.path for each in removed})
    return removed


def _tidy(folder: CatalogFolder, gone: set[Path]) -> None:
    """Update `metadata.yaml` after files were removed, or remove the folder if nothing is left."""
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
