"""The judgement of one recording by this robotctl: a pure function of its bytes and parameters."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from robotctl import __version__
from robotctl.errors import ConfigError, UnreadableFile
from robotctl.fleet.change import Change, change_of
from robotctl.fleet.outcome import outcome_of
from robotctl.fleet.recording_content import Content, read_content
from robotctl.fleet.software import software_hash
from robotctl.recording.read.read_failures import noted_read_failures
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Divergence, Report
from robotctl.rerun.whatif import what_if

VerdictName = Literal["diverged", "broken", "crashed", "incomplete", "unfit", "unreadable", "same"]
"""Those of `replay --check`, and three more; the most severe first.

In the gate a recording is `diverged` whatever version recorded it. `crashed` is one at which
robotctl itself fails, `unfit` one whose parameters do not fit together with the other ones, and
`unreadable` one from which other parameters can decide nothing.
"""

VERDICTS: Final[tuple[VerdictName, ...]] = VerdictName.__args__  # type: ignore[attr-defined]

FAILED: Final = ("diverged", "broken", "crashed")
"""The verdicts that close the gate; with other parameters also a change of modes or answers."""

UNKNOWN: Final = ("incomplete", "unfit", "unreadable")

_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


@dataclass(frozen=True, slots=True)
class Judgement:
    """What the gate knows of one recording.

    `recording` is the SHA-256 of its files and `software` that of robotctl. `says` is the first
    sentence about what is wrong, `cause` the same without its numbers, "" if all is the same, and
    `outcome` the SHA-256 over all that is wrong and changed. `other` is what other parameters
    change, where they were asked for.
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
        """The name of this result: the same bytes, software and parameters give the same."""
        return key_of(self.recording, self.settings)

    @property
    def differs(self) -> bool:
        """Whether other parameters change modes or answers, not only velocities."""
        return self.other is not None and self.other.differs

    def as_object(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)


def judge(path: Path, settings: Mapping[str, str], content: Content | None = None) -> Judgement:
    """Decide a recording again, and with other parameters if there are settings.

    `content` is given if it was read before.

    Raises:
        OSError: A file cannot be read, also not a part of it.
        UnreadableFile: There are no files, or a process writes or has changed them.
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
    """Return the judgement of a recording at which robotctl itself fails."""
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
    """Return the name of the result for a recording, by its hash, and settings."""
    parts = [recording, software_hash(), *(f"{key}={settings[key]}" for key in sorted(settings))]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _checked(
    path: Path, settings: Mapping[str, str]
) -> tuple[Report | None, VerdictName, str, Change | None]:
    """Return report, verdict, first sentence and what other parameters change."""
    try:
        report = check_recording(path)
    except UnreadableFile as error:
        return None, "unreadable", str(error), None
    verdict, says = _verdict(report)
    if not settings:
        return report, verdict, says, None
    try:
        other = change_of(what_if(path, settings))
    except ConfigError as error:
        problem: tuple[VerdictName, str] = "unfit", f"the parameters do not fit: {error}"
    except UnreadableFile as error:
        problem = "unreadable", str(error)
    else:
        if verdict == "same" and other.missing:
            return report, "incomplete", other.missing[0], other
        return report, verdict, says, other
    return (report, verdict, says, None) if verdict in FAILED else (report, *problem, None)


def _verdict(report: Report) -> tuple[VerdictName, str]:
    """Return the verdict in the gate and the first sentence about what is wrong."""
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
    if name and not fields.startswith("{"):  # no effect, but what the kernel raised
        return f"the kernel fails: {name}: {fields[:200]}"
    return f"{name or 'nothing'} was decided"


def _cause(sentence: str) -> str:
    return _NUMBER.sub("N", sentence)[:200]
