"""Judges one recording by repeating its decisions with the recorded and with other parameters."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, Literal, TypeVar, cast

import msgspec

import robotctl
from robotctl import __version__
from robotctl.base.errors import ConfigError, UnreadableFile
from robotctl.base.files import open_regular
from robotctl.check.report import Divergence, Report, rounded
from robotctl.check.run import check_recording
from robotctl.check.what_if import what_if
from robotctl.recording.format.disk import is_being_written
from robotctl.recording.format.names import MADE_BY
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.read.files import recording_files
from robotctl.recording.read.read_limits import noted_read_failures

if TYPE_CHECKING:
    from io import BufferedReader


class BeingWritten(UnreadableFile):
    """A running process is still writing the recording."""


@dataclass(frozen=True, slots=True)
class Content:
    """The state of a recording, with a SHA-256 over its files' names and contents."""

    digest: str
    _marks: tuple[tuple[int, ...], ...]
    """Size, mtime [ns], ctime [ns] and inode of each file."""

    def check(self, path: Path) -> None:
        """Check that the files have not changed since the content was read.

        Raises:
            OSError: A file does not exist any more or cannot be examined.
            UnreadableFile: A file has changed.
        """
        if tuple(_marks(path)) != self._marks:
            raise UnreadableFile(f"{path.name} was changed while it was read")


def read_content(path: Path) -> Content:
    """Read all files of a recording, and return the hash of its content.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: The recording has no files.
        BeingWritten: A process is still writing the recording.
    """
    digest = hashlib.sha256()
    for file in recording_files(path):
        with suppress(OSError):  # a file system without locks; errors of opening are raised below
            if is_being_written(file):
                raise BeingWritten(f"{path.name} is being written")
    marks = tuple(_marks(path))
    for file in _files(path):
        with open_regular(file) as opened:
            content = hashlib.file_digest(cast("BufferedReader", opened), "sha256").hexdigest()
        digest.update(f"{file.name}\n{content}\n".encode())
    return Content(digest.hexdigest(), marks)


def _files(path: Path) -> Iterator[Path]:
    yield from recording_files(path)
    metadata = (path if path.is_dir() else path.parent) / METADATA_FILE
    if metadata.is_file():
        yield metadata


def _marks(path: Path) -> Iterator[tuple[int, ...]]:
    for file in _files(path):
        status = file.stat()
        yield status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


@cache
def software_hash() -> str:
    """Return the SHA-256 over all modules of robotctl, its version, Python and the C library."""
    package = Path(robotctl.__file__).parent
    digest = hashlib.sha256(f"{robotctl.__version__}\n{MADE_BY}\n".encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def software_name() -> str:
    """Return the versions of robotctl, Python and the C library as readable text."""
    return f"robotctl {robotctl.__version__} on {MADE_BY}"


Kind = TypeVar("Kind")


class Typed(Generic[Kind]):
    """Converts parsed JSON to objects of one class. Create it only at import: not thread-safe."""

    def __init__(self, kind: type[Kind]) -> None:
        self._kind = kind
        msgspec.json.Decoder(kind)  # prepares it; two threads that do this at once crash Python

    def __call__(self, value: Any) -> Kind:
        """Return the value as an object of the class.

        Raises:
            ValueError: The value does not fit the class.
        """
        try:
            return msgspec.convert(value, self._kind)
        except (msgspec.ValidationError, RecursionError) as error:
            raise ValueError(str(error)) from error


Change = dict[str, Any]
"""The JSON object of `replay --what-if --json` for a recording, without its path."""


def totals_of(changes: Iterable[Change]) -> dict[str, Any]:
    """Return sums and maxima over all drives and modes, as recorded and as re-run, for JSON."""
    every = list(changes)
    drives = [drive for change in every for drive in change["drives"]]
    modes = dict.fromkeys(mode for change in every for mode in change["modes_s"])

    def both(total: Callable[[str], float]) -> dict[str, float]:
        return {side: total(side) for side in ("recorded", "what_if")}

    def of_drives(key: str, side: str) -> list[float]:
        return [each[side][key] for each in drives if each[side] is not None]

    def largest(key: str, side: str) -> float:
        return max(of_drives(key, side), default=0.0)

    def in_mode(mode: str, side: str) -> float:
        times = (each["modes_s"].get(mode) for each in every)
        return sum((each[side] for each in times if each), 0.0)

    return {
        "drives": len(drives),
        "end_otherwise": sum(map(ends_otherwise, drives)),
        "modes_s": {mode: both(partial(in_mode, mode)) for mode in modes},
        "commanded_m": both(lambda side: sum(of_drives("commanded_m", side))),
        "max_linear_mps": both(partial(largest, "max_linear_mps")),
        "max_angular_rps": both(partial(largest, "max_angular_rps")),
    }


def ends_otherwise(drive: Mapping[str, Any]) -> bool:
    """Return whether a drive ended differently with other parameters, or is in one run only."""
    mine, theirs = drive["recorded"], drive["what_if"]
    if mine is None or theirs is None:
        return True
    return any(mine[key] != theirs[key] for key in ("completed", "cause", "end_mode"))


_OTHER_RULES = re.compile(r"decided by the rules of another version \([^)]*\): ")


def outcome_of(
    path: Path | None,
    verdict: str,
    says: str,
    settings: Mapping[str, str],
    report: Report | None,
    other: Change | None,
) -> str:
    """Return a SHA-256 of the verdict, the findings, the `settings`, and what these change.

    The path of the recording and the version of robotctl do not change the hash.
    """
    found = None if report is None else report.divergence
    parts = {
        "verdict": verdict,
        "says": _OTHER_RULES.sub("", says) if found is None else "",
        "settings": dict(settings),
        "divergence": None
        if found is None
        else [found.seq, found.event, found.recorded, found.decided, *found.differences],
        "divergences": None if report is None else [report.divergences, report.divergences_crc],
        "violations": [] if report is None else [each.text for each in report.violations],
        "violation_count": 0 if report is None else report.violation_count,
        "missing": [] if report is None else _missing(report),
        "other": other,
    }
    text = json.dumps(parts, sort_keys=True)
    if path is not None:
        text = text.replace(json.dumps(str(path))[1:-1], path.name)
    return hashlib.sha256(rounded(text).encode()).hexdigest()


def _missing(report: Report) -> list[str]:
    """Return `report.missing` without the names of versions, and without the first divergence."""
    found = "" if report.divergence is None else report.divergence.sentence()
    sentences = [_OTHER_RULES.sub("", each) for each in report.missing]
    return [each for each in sentences if each != found]


VerdictName = Literal["diverged", "broken", "crashed", "incomplete", "unfit", "unreadable", "same"]
"""The verdicts of `replay --check` and three more, the most severe first.

`crashed`: robotctl fails on the recording. `unfit`: its parameters conflict with those to try.
`unreadable`: it cannot be read. `diverged` includes divergence under another version's rules.
"""

VERDICTS: Final[tuple[VerdictName, ...]] = VerdictName.__args__  # type: ignore[attr-defined]

FAILED: Final = ("diverged", "broken", "crashed")
"""The verdicts that fail the gate, as does a change of modes or answers."""

UNKNOWN: Final = ("incomplete", "unfit", "unreadable")

_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


@dataclass(frozen=True, slots=True)
class Judgement:
    """The result of the gate for one recording.

    `recording`, `software` and `outcome` are SHA-256 hashes. `says` is the first finding, "" if
    nothing is wrong, and `cause` the same without numbers.
    """

    recording: str
    software: str
    settings: dict[str, str]
    verdict: VerdictName
    cause: str
    says: str
    outcome: str
    other: Change | None

    @property
    def key(self) -> str:
        """The key of this judgement in a `ResultStore`."""
        return key_of(self.recording, self.settings)

    @property
    def differs(self) -> bool:
        """Whether the re-run with other parameters changes modes or replies, or fails."""
        other = self.other or {}
        return any(other.get(key) for key in ("mode_differs_s", "answer_count", "failure"))

    def as_object(self) -> dict[str, Any]:
        """Return the judgement as JSON values."""
        return asdict(self)


def judge(path: Path, settings: Mapping[str, str], content: Content | None = None) -> Judgement:
    """Judge a re-run of a recording with its own parameters, and one with `settings` if any.

    Raises:
        OSError: A file cannot be read.
        UnreadableFile: There are no files, a part of a file cannot be read, or a file changes.
    """
    content = content or read_content(path)
    with noted_read_failures() as failures:
        report, verdict, says, other = _checked(path, settings)
    content.check(path)
    if failures:
        raise UnreadableFile(failures[0])
    return Judgement(
        recording=content.digest,
        software=software_hash(),
        settings=dict(settings),
        verdict=verdict,
        cause=_cause(says),
        says=says,
        outcome=outcome_of(path, verdict, says, settings, report, other),
        other=other,
    )


def crashed(content: Content, settings: Mapping[str, str], error: Exception) -> Judgement:
    """Return the judgement of a recording on which robotctl itself fails."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = "" if trace is None else f" in {Path(trace.tb_frame.f_code.co_filename).name}"
    line = "" if trace is None else f", line {trace.tb_lineno}"
    says = f"robotctl failed{where}{line}: {type(error).__name__}: {error}"[:400]
    return Judgement(
        recording=content.digest,
        software=software_hash(),
        settings=dict(settings),
        verdict="crashed",
        cause=_cause(says),
        says=says,
        outcome=outcome_of(None, "crashed", says, settings, None, None),
        other=None,
    )


def key_of(recording: str, settings: Mapping[str, str]) -> str:
    """Return the key of a stored result: a hash over `recording` (a hash), software, settings."""
    parts = [recording, software_hash(), *(f"{key}={settings[key]}" for key in sorted(settings))]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _checked(
    path: Path, settings: Mapping[str, str]
) -> tuple[Report | None, VerdictName, str, Change | None]:
    """Return the check's report, verdict and first finding, and the changes by `settings`."""
    try:
        report = check_recording(path)
    except UnreadableFile as error:
        return None, "unreadable", str(error), None
    verdict, says = _verdict(report)
    if not settings:
        return report, verdict, says, None
    try:
        other = what_if(path, settings)
        del other["path"]
    except ConfigError as error:
        problem: tuple[VerdictName, str] = "unfit", f"the parameters do not fit: {error}"
    except UnreadableFile as error:
        problem = "unreadable", str(error)
    else:
        if verdict == "same" and other["missing"]:
            return report, "incomplete", other["missing"][0], other
        return report, verdict, says, other
    return (report, verdict, says, None) if verdict in FAILED else (report, *problem, None)


def _verdict(report: Report) -> tuple[VerdictName, str]:
    """Return the gate's verdict, and the first finding as a sentence, "" if there is none."""
    if (found := report.divergence) is not None:
        other = "" if report.version == __version__ else report.version or "another version"
        by = f" (recorded by {other})" if other else ""
        event = found.event.partition(" ")[0]
        return "diverged", f"after {event} at entry {found.seq}: {_difference(found)}{by}"
    verdict: VerdictName = report.verdict.value
    if report.violations:
        return verdict, report.violations[0].text
    return verdict, report.missing[0] if report.missing else ""


def _difference(found: Divergence) -> str:
    if found.differences:
        return "; ".join(found.differences)
    name, _, fields = found.decided.partition(" ")
    if name and not fields.startswith("{"):  # not an effect, but an error of the kernel
        return f"the kernel fails: {name}: {fields[:200]}"
    return f"{name or 'nothing'} was decided"


def _cause(sentence: str) -> str:
    return _NUMBER.sub("N", sentence)[:200]
