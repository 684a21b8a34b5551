"""The judgement of one recording by this robotctl: a pure function of its bytes and parameters."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import robotctl
from robotctl.errors import RobotctlError
from robotctl.recording.read.files import recording_files
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.rerun.whatif import what_if
from robotctl.store.store_path import StorePath

UNREADABLE: Final = "unreadable"
"""The verdict where nothing can be read."""

_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


@dataclass(frozen=True, slots=True)
class Judgement:
    """What the gate knows of one recording.

    `recording` is the SHA-256 of its files and `software` that of robotctl. `says` is the first
    sentence about what is wrong, and `cause` the same without its numbers, "" if all is the same.
    `other` is the object of `replay --what-if` where other parameters were asked for.
    """

    recording: str
    software: str
    settings: dict[str, str]
    verdict: str
    cause: str
    says: str
    other: dict[str, Any] | None

    @property
    def key(self) -> str:
        """The name of this result: the same bytes, software and parameters give the same."""
        return key_of(self.recording, self.settings)

    @property
    def differs(self) -> bool:
        """Whether other parameters change modes or answers, not only velocities."""
        other = self.other
        return other is not None and bool(other["mode_differs_s"] or other["answer_count"])

    def as_object(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def judge(path: Path, settings: Mapping[str, str]) -> Judgement:
    """Decide a recording again, and with other parameters if there are settings.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: There are no files, or their store has failed.
    """
    content = content_hash(path)
    try:
        report = check_recording(path)
        other = what_if(path, settings) if settings else None
    except RobotctlError as error:
        _check_store(path)
        said = str(error)
        return Judgement(
            content, software_hash(), dict(settings), UNREADABLE, _cause(said), said, None
        )
    _check_store(path)
    said = _first(report)
    return Judgement(
        recording=content,
        software=software_hash(),
        settings=dict(settings),
        verdict=report.verdict.value,
        cause=_cause(said),
        says=said,
        other=other,
    )


def key_of(recording: str, settings: Mapping[str, str]) -> str:
    """Return the name of the result for a recording, by its hash, and settings."""
    parts = [recording, software_hash(), *(f"{key}={settings[key]}" for key in sorted(settings))]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def content_hash(path: Path) -> str:
    """Return the SHA-256 over the names and contents of a recording's files.

    A file in a store is not read: its ETag stands for its content. So the hash is not that of the
    same file on a disk, of which a check also reads every byte.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: There are no files.
    """
    digest = hashlib.sha256()
    for file in recording_files(path):
        digest.update(f"{file.name}\n{_content(file)}\n".encode())
    return digest.hexdigest()


def _content(file: Path) -> str:
    """Return the hash of a file; of one in a store, size and ETag."""
    if isinstance(file, StorePath):
        found = file.described()
        return f"{found.size_bytes} {found.etag}"
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


@cache
def software_hash() -> str:
    """Return the SHA-256 over all modules of robotctl, and its version."""
    package = Path(robotctl.__file__).parent
    digest = hashlib.sha256(robotctl.__version__.encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _check_store(path: Path) -> None:
    """Raise what a store could not tell just now: it is no property of the recording."""
    if isinstance(path, StorePath):
        path.check()


def _first(report: Report) -> str:
    """Return the first sentence about what is wrong."""
    if report.verdict is Verdict.DIVERGED and report.divergence is not None:
        found = report.divergence
        event, decided = found.event.partition(" ")[0], found.decided.partition(" ")[0]
        what = "; ".join(found.differences) or f"{decided or 'nothing'} was decided"
        return f"after {event} at entry {found.seq}: {what}"
    if report.violations:
        return report.violations[0].text
    return report.missing[0] if report.missing else ""


def _cause(sentence: str) -> str:
    return _NUMBER.sub("N", sentence)[:200]
