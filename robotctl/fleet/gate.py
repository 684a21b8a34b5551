"""Judges every recording of a folder, and says whether history lets this robotctl pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.fleet.baseline import Accepted, Baseline
from robotctl.fleet.change import Totals, totals_of
from robotctl.fleet.jobs import Done
from robotctl.fleet.judgement import FAILED, UNKNOWN, VERDICTS, Judgement
from robotctl.fleet.judging import Engine, Judging, judge_here
from robotctl.fleet.result_store import ResultStore
from robotctl.fleet.software import software_hash

CHANGED: Final = "changed"
"""The cause of a recording where other parameters change modes or answers."""


@dataclass(slots=True)
class GateReport:
    """The judgements of the recordings by their paths, in that order.

    `stored` counts those that were in the store already. `lost` are recordings whose process was
    killed twice, or whose files cannot be read. `live` are those that are being written: they are
    left out.
    """

    results: dict[Path, Judgement] = field(default_factory=dict)
    accepted: dict[Path, Accepted] = field(default_factory=dict)
    lost: dict[Path, str] = field(default_factory=dict)
    live: list[Path] = field(default_factory=list)
    stored: int = 0

    def pass_accepted(self, baseline: Baseline) -> None:
        """Let pass what the baseline accepts."""
        for path, result in self.results.items():
            if (by := baseline.find(result)) is not None:
                self.accepted[path] = by

    def failures(self) -> dict[Path, Judgement]:
        """Return what closes the gate and is not accepted."""
        return {path: each for path, each in self._open() if each.verdict in FAILED or each.differs}

    def unknown(self) -> dict[Path, Judgement]:
        """Return what could not be judged completely and is not accepted."""
        return {
            path: each
            for path, each in self._open()
            if each.verdict in UNKNOWN and not each.differs
        }

    def counts(self) -> dict[str, int]:
        """Return how many recordings have each verdict."""
        found = Counter(each.verdict for each in self.results.values())
        return {verdict: found[verdict] for verdict in VERDICTS}

    def causes(self) -> dict[str, list[Path]]:
        """Return what is not the same by its cause, the most frequent first."""
        wrong = self.failures() | self.unknown()
        return _grouped({path: cause_of(each) for path, each in wrong.items()})

    def lost_causes(self) -> dict[str, list[Path]]:
        """Return what was lost by its reason, the most frequent first."""
        return _grouped(self.lost)

    def acceptances(self) -> dict[tuple[str, str, str], list[Path]]:
        """Return what was accepted, by whom, when and why."""
        groups: dict[tuple[str, str, str], list[Path]] = {}
        for path, each in self.accepted.items():
            groups.setdefault((each.by, each.at, each.why), []).append(path)
        return groups

    def totals(self) -> Totals | None:
        """Return what other parameters change in all drives; None if none were asked for."""
        changes = [each.other for each in self.results.values() if each.other is not None]
        return totals_of(changes) if changes else None

    def _open(self) -> list[tuple[Path, Judgement]]:
        return [item for item in self.results.items() if item[0] not in self.accepted]


def cause_of(result: Judgement) -> str:
    """Return the verdict with its cause; that of other parameters where they change something."""
    if result.verdict not in FAILED and result.differs:
        failure = None if result.other is None else result.other.failure
        if failure is not None:
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
    """Judge recordings; those with a stored result are not judged again.

    Recordings that are being written are left out. Each result is stored as soon as it is there, so
    a run that is killed goes on where it was.

    Raises:
        Refused: A result cannot be stored, or the engine is not there.
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
