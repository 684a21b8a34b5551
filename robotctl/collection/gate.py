"""Judges the recordings of a folder with this robotctl, also under other kernel parameters."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from robotctl.base.errors import ConfigError, Refused
from robotctl.base.files import open_regular
from robotctl.base.pool import Done
from robotctl.base.text import printable
from robotctl.collection.judgement import (
    FAILED,
    UNKNOWN,
    VERDICTS,
    Judgement,
    Typed,
    software_hash,
    totals_of,
)
from robotctl.collection.judging import Engine, Judging, ResultStore, judge_here
from robotctl.recording.format.disk import replaced_file

MAX_BYTES: Final = 64 << 20

FORMAT: Final = 2
"""The format of a baseline file."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """A result that the person `by` has accepted.

    `recording` and `outcome` are hashes of the recording's files and of the check's findings.
    """

    name: str
    recording: str
    settings: dict[str, str]
    outcome: str
    verdict: str
    says: str
    by: str
    why: str
    at: str
    """The time of acceptance, ISO 8601."""


@dataclass(frozen=True, slots=True)
class _File:
    format: int
    accepted: tuple[Accepted, ...]


_file = Typed(_File)

_Key = tuple[str, tuple[tuple[str, str], ...], str]


class Baseline:
    """The results that were accepted, by recording, settings and outcome."""

    def __init__(self, accepted: Iterable[Accepted] = ()) -> None:
        self._accepted = {
            _key(each.recording, each.settings, each.outcome): each for each in accepted
        }

    def find(self, result: Judgement) -> Accepted | None:
        """Return the entry that accepts this result, None if there is none."""
        return self._accepted.get(_key(result.recording, result.settings, result.outcome))

    def accept(self, name: str, result: Judgement, *, by: str, why: str, at: str) -> None:
        """Add an entry for a result that the person `by` accepts at the time `at` [ISO 8601]."""
        recording, settings, outcome = result.recording, result.settings, result.outcome
        says = result.says or "other parameters change modes or answers"
        self._accepted[_key(recording, settings, outcome)] = Accepted(
            name, recording, settings, outcome, result.verdict, says, by, why, at
        )

    def write(self, path: Path) -> None:
        """Write the baseline to a file, completely or not at all.

        Raises:
            Refused: The file cannot be written.
        """
        accepted = sorted(self._accepted.values(), key=lambda each: (each.name, each.says))
        file = {"format": FORMAT, "accepted": [asdict(each) for each in accepted]}
        try:
            with replaced_file(path) as opened:
                opened.write(f"{json.dumps(file, indent=2)}\n".encode())
        except OSError as error:
            raise Refused(f"cannot write {path}: {error.strerror or error}") from error


def read_baseline(path: Path) -> Baseline:
    """Return the baseline in a file, an empty baseline if there is no file.

    Raises:
        ConfigError: The file cannot be read, is not a baseline, or has another format.
    """
    try:
        with open_regular(path) as opened:
            found = json.loads(opened.read(MAX_BYTES))
        if isinstance(found, dict) and "accepted" in found and "format" not in found:
            raise ConfigError(
                f"{path} is not a baseline of this gate: an older robotctl wrote it, which "
                f"accepted other parameters and other numbers, too",
                "name a new file, and accept again what is still right",
            )
        file = _file(found)
        if file.format != FORMAT:
            raise ValueError(f"it has the format {file.format}, this robotctl knows {FORMAT}")
    except FileNotFoundError:
        return Baseline()
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not a baseline of the gate: {error}") from None
    return Baseline(file.accepted)


def _key(recording: str, settings: Mapping[str, str], outcome: str) -> _Key:
    return recording, tuple(sorted(settings.items())), outcome


CHANGED: Final = "changed"
"""The first word of `cause_of` if a recording fails only with other parameters."""


@dataclass(slots=True)
class GateReport:
    """The judgements of recordings by path, in the order of the recordings.

    `lost` has the reasons for missing judgements. `live` recordings are still being written.
    """

    results: dict[Path, Judgement] = field(default_factory=dict)
    accepted: dict[Path, Accepted] = field(default_factory=dict)
    lost: dict[Path, str] = field(default_factory=dict)
    live: list[Path] = field(default_factory=list)
    stored: int = 0

    def pass_accepted(self, baseline: Baseline) -> None:
        """Add to `accepted` each result that the baseline accepts."""
        for path, result in self.results.items():
            if (by := baseline.find(result)) is not None:
                self.accepted[path] = by

    def failures(self) -> dict[Path, Judgement]:
        """Return the results that fail the gate and are not accepted."""
        return {path: each for path, each in self._open() if each.verdict in FAILED or each.differs}

    def unknown(self) -> dict[Path, Judgement]:
        """Return the results that could not be judged completely and are not accepted."""
        return {
            path: each
            for path, each in self._open()
            if each.verdict in UNKNOWN and not each.differs
        }

    def counts(self) -> dict[str, int]:
        """Return the number of recordings by verdict."""
        found = Counter(each.verdict for each in self.results.values())
        return {verdict: found[verdict] for verdict in VERDICTS}

    def causes(self) -> dict[str, list[Path]]:
        """Return cause -> recordings in `failures` and `unknown`, the most frequent cause first."""
        wrong = self.failures() | self.unknown()
        return _grouped({path: cause_of(each) for path, each in wrong.items()})

    def lost_causes(self) -> dict[str, list[Path]]:
        """Return the lost recordings by reason, the most frequent reason first."""
        return _grouped(self.lost)

    def acceptances(self) -> dict[tuple[str, str, str], list[Path]]:
        """Return the accepted recordings by person, time and reason."""
        groups: dict[tuple[str, str, str], list[Path]] = {}
        for path, each in self.accepted.items():
            groups.setdefault((each.by, each.at, each.why), []).append(path)
        return groups

    def totals(self) -> dict[str, Any] | None:
        """Return sums and maxima over all drives, None if none was re-run with other parameters."""
        changes = [each.other for each in self.results.values() if each.other is not None]
        return totals_of(changes) if changes else None

    def _open(self) -> list[tuple[Path, Judgement]]:
        return [item for item in self.results.items() if item[0] not in self.accepted]


def cause_of(result: Judgement) -> str:
    """Return "VERDICT: CAUSE"; "changed: CAUSE" if the result fails only with other parameters."""
    if result.verdict not in FAILED and result.differs:
        if result.other is not None and result.other["failure"]:
            return f"{CHANGED}: the kernel fails with other parameters"
        return f"{CHANGED}: other parameters change modes or answers"
    return f"{result.verdict}: {result.cause}"


def _grouped(reasons: Mapping[Path, str]) -> dict[str, list[Path]]:
    groups: dict[str, list[Path]] = {}
    for path, reason in reasons.items():
        groups.setdefault(reason, []).append(path)
    return dict(sorted(groups.items(), key=lambda item: (-len(item[1]), item[0])))


def judge_all(
    recordings: Sequence[Path],
    store: ResultStore,
    settings: Mapping[str, str],
    baseline: Baseline,
    engine: Engine = judge_here,
    on_progress: Done = lambda done, total: None,
) -> GateReport:
    """Judge recordings, and return the report.

    `settings` are other parameters to try. Results in the store are not computed again.

    Raises:
        Refused: A result cannot be stored, or the `engine` (a Dask cluster) is not available.
    """
    found: dict[Path, Judgement] = {}
    report = GateReport()
    judging = Judging(dict(settings), store, software_hash())
    for path, answer in engine(judging, recordings, on_progress):
        if answer is None:
            report.lost[path] = "the process that judged it was killed"
        elif answer.live:
            report.live.append(path)
        elif answer.judgement is None:
            report.lost[path] = answer.problem
        else:
            found[path] = answer.judgement
            report.stored += answer.was_stored
    report.live.sort()
    report.results = {path: found[path] for path in recordings if path in found}
    report.pass_accepted(baseline)
    return report


def junit_text(report: GateReport) -> str:
    """Return the report as JUnit XML with a test case per recording."""
    failures, unknown = report.failures(), report.unknown()
    suite = ElementTree.Element(
        "testsuite",
        name="robotctl gate",
        tests=str(len(report.results) + len(report.lost) + len(report.live)),
        failures=str(len(failures)),
        errors=str(len(unknown) + len(report.lost)),
        skipped=str(len(report.live)),
    )

    def case_of(path: Path) -> ElementTree.Element:
        name = printable(path.name)
        return ElementTree.SubElement(suite, "testcase", classname="recording", name=name)

    for path, result in report.results.items():
        case = case_of(path)
        if path in failures or path in unknown:
            kind = "failure" if path in failures else "error"
            message = printable(cause_of(result))
            verdict = message.partition(":")[0]
            note = ElementTree.SubElement(case, kind, type=verdict, message=message)
            note.text = printable(result.says)
        elif path in report.accepted:
            by = report.accepted[path]
            out = ElementTree.SubElement(case, "system-out")
            out.text = printable(f"accepted by {by.by} at {by.at}: {by.why}")
    for path, said in report.lost.items():
        ElementTree.SubElement(case_of(path), "error", type="lost", message=printable(said))
    for path in report.live:
        ElementTree.SubElement(case_of(path), "skipped", message="it is being written")
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
