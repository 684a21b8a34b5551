"""Removes recordings here that retention ends, each file after it was read back from the store."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from robotctl.collect.collecting import GIVE_UP_AFTER
from robotctl.collect.local_files import Pace, sha256_of
from robotctl.collect.object_names import CollectedRecording, ObjectName, collected_recordings
from robotctl.collect.read_back import WrongContent, check_content, read_manifest
from robotctl.errors import RobotctlError, UnreadableFile
from robotctl.recording.disk.disk_errors import reason_of
from robotctl.recording.keep.catalog import CatalogFile, CatalogFolder
from robotctl.recording.keep.removal_notes import note_removal, withdraw_note
from robotctl.recording.keep.retention import Removed, RetentionPolicy, enforce_retention
from robotctl.store import ObjectStore, StoreError


@dataclass(slots=True)
class Pruned:
    """What was removed, and a sentence for each file that was not because of the store."""

    removed: list[Removed] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Objects that do not hold what their name says."""


def prune(
    recordings: Path,
    store: ObjectStore,
    policy: RetentionPolicy,
    now_s: float,
    *,
    pace: Pace = lambda count: None,
) -> Pruned:
    """Remove what exceeds `policy`, the oldest first, as retention does.

    A file is removed only if the newest manifest of its recording names it, and if the bytes that
    the store sends now are those that the file holds now. `now_s` is in seconds since the epoch.

    Raises:
        OSError: The folder cannot be listed.
    """
    pruned = Pruned()
    there: dict[str, CollectedRecording] = {}
    failed = 0

    def is_stored(file: CatalogFile, folder: CatalogFolder) -> bool:
        nonlocal failed
        if failed == GIVE_UP_AFTER:
            return False
        name = folder.path.name
        try:
            if name not in there:
                there[name] = collected_recordings(store.list(name)).get(name, CollectedRecording())
            _check_stored(file, folder, store, there[name], pace)
            note_removal(recordings, file.path, f"removed after its copy to {store.name} was read")
        except WrongContent as error:
            pruned.wrong.append(str(error))
            failed = 0
        except OSError as error:
            cause = f"its removal cannot be noted: {reason_of(error)}"
            pruned.problems.append(f"{file.path.name} is kept: {cause}")
        except RobotctlError as error:
            pruned.problems.append(f"{file.path.name} is kept: {error}")
            failed = failed + 1 if isinstance(error, StoreError) else 0
        else:
            failed = 0
            return True
        return False

    def not_removed(file: CatalogFile, error: OSError) -> None:
        with suppress(OSError):
            withdraw_note(recordings, file.path)
        if not isinstance(error, FileNotFoundError):
            cause = f"it cannot be removed: {reason_of(error)}"
            pruned.problems.append(f"{file.path.name} is kept: {cause}")

    pruned.removed = enforce_retention(
        recordings, policy, now_s, may_remove=is_stored, on_failure=not_removed
    )
    return pruned


def _check_stored(
    file: CatalogFile,
    folder: CatalogFolder,
    store: ObjectStore,
    there: CollectedRecording,
    pace: Pace,
) -> None:
    """Raise an error unless the store holds the bytes of a file and its manifest names them."""
    if there.manifest is None:
        raise UnreadableFile("its recording is not completely in the store")
    relative = file.path.relative_to(folder.path).as_posix()
    files = {each.name: each for each in read_manifest(store, there).files}
    if (named := files.get(relative)) is None:
        raise UnreadableFile("the manifest of its recording does not name it")
    name = ObjectName(folder.path.name, named.sha256, relative)
    check_content(store, name, named.size_bytes, pace)
    if sha256_of(file.path, pace) != named.sha256:  # last: nothing is between it and the removal
        raise UnreadableFile("the store holds another content")
