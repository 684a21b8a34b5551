"""The recordings of a robot: those that its journal of decisions names, and others beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from robotctl.decisions.evidence import Evidence
from robotctl.errors import UnreadableFile
from robotctl.recording import read_info
from robotctl.recording.format.metadata_names import INFO_RECORD, PARAMETER_PREFIX
from robotctl.recording.keep.listing import ListedRecording, list_recording
from robotctl.recording.read.files import recording_files
from robotctl.recording.seal.heads import HeadsList

_HEAD = "decisions"
_KEEP_YEARS = f"{PARAMETER_PREFIX}decisions.keep_years"


class RecordingState(StrEnum):
    """What has become of a recording."""

    LIVE = "live"
    KEPT = "kept"
    THERE = "there"
    REMOVED = "removed"
    """The journal says of each of its files that retention removed it."""

    MISSING = "missing"


@dataclass(frozen=True, slots=True)
class FileOfJournal:
    """What a file of a recording tells of the journal: the hash of its newest entry when the file
    began, None in a file of an earlier version, and for how many years it is kept (0: forever).
    """

    name: str
    start_ns: int
    head: str | None
    keep_years: float | None


@dataclass(frozen=True, slots=True)
class EvidenceRecording:
    """A recording; `named` is False if no entry of the journal names it."""

    path: Path
    state: RecordingState
    named: bool
    listed: ListedRecording | None = None
    files: tuple[FileOfJournal, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordingSearch:
    """Where to look for the recordings of a robot.

    In `folders`, and beside the recordings that the journal names, others are looked for as well.
    `elsewhere` may hold copies of those that are no more where they were made. `heads`, the
    robot's list of sealed files, tells which files a recording had.
    """

    robot: str
    folders: Collection[Path]
    elsewhere: Path | None
    since_ns: int
    heads: HeadsList = field(default_factory=HeadsList)

    def find(self, told: Evidence, since: Evidence) -> Iterator[EvidenceRecording]:
        """Yield the recordings that the journal names `since` a time, then others beside them.

        Of what is `told` to be older, a recording is left out if its own messages are older too.
        """
        wanted = set(since.recordings())
        seen = set()
        removed = {str(item.get("file")) for item in told.removed}
        for name in told.recordings():
            path = Path(name)
            if self.elsewhere is not None and not path.exists():
                path = self.elsewhere / path.name
            seen.add(path.name)
            found = _look(path, named=True) or self._gone(path, removed)
            if name in wanted or self._is_later(found):
                yield found
        for path in self._beside(told.recordings()):
            other = None if path.name in seen else _look(path, named=False)
            seen.add(path.name)
            if other is not None and self._is_later(other) and self._is_own(other):
                yield other

    def _is_later(self, found: EvidenceRecording) -> bool:
        return found.listed is not None and found.listed.end_ns >= self.since_ns

    def _is_own(self, found: EvidenceRecording) -> bool:
        """Return whether the robot recorded it, with a version that has a journal of decisions."""
        assert found.listed is not None
        if any(self.heads.keys_of(file.name) for file in found.files):
            return True
        noted = any(file.head is not None for file in found.files)
        return noted and found.listed.robot == self.robot

    def _beside(self, named: Sequence[str]) -> Iterator[Path]:
        for folder in sorted({*self.folders, *(Path(name).parent for name in named)}):
            with suppress(OSError):
                for path in sorted(folder.iterdir()):
                    if path.name.startswith(f"{self.robot}_") and path.is_dir():
                        yield path

    def _gone(self, path: Path, removed: Collection[str]) -> EvidenceRecording:
        """Return a recording that is not there, with whether all its known files were `removed`."""
        names = {Path(file).name for file in removed if Path(file).parent.name == path.name}
        sealed = {
            opening.file
            for opening in self.heads.opened.values()
            if opening.file.rpartition("_")[0] == path.name
        }
        is_removed = bool(names) and sealed <= names
        state = RecordingState.REMOVED if is_removed else RecordingState.MISSING
        return EvidenceRecording(path, state, named=True)


def _look(path: Path, *, named: bool) -> EvidenceRecording | None:
    """Return the recording at a path, None if there is none."""
    try:
        listed = list_recording(path)
    except OSError:
        return None
    state = RecordingState.THERE
    if listed.live:
        state = RecordingState.LIVE
    elif listed.kept:
        state = RecordingState.KEPT
    return EvidenceRecording(path, state, named, listed, tuple(_files(path)))


def _files(recording: Path) -> Iterator[FileOfJournal]:
    try:
        files = recording_files(recording)
    except UnreadableFile:
        return  # its verdict tells why
    for file in files:
        with suppress(UnreadableFile):
            info = read_info(file)
            told = info.metadata.get(INFO_RECORD, {})
            keep_years = None
            with suppress(ValueError, KeyError):
                keep_years = float(told[_KEEP_YEARS])
            yield FileOfJournal(file.name, info.start_ns, told.get(_HEAD), keep_years)
