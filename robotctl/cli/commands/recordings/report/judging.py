"""What `replay --check`, `verify` and `why` say of a recording, for its report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from robotctl.base.errors import UnreadableFile
from robotctl.check.incident import find_incident
from robotctl.check.many import check_recordings
from robotctl.check.report import Verdict
from robotctl.cli.commands.recordings.verify import verify_together
from robotctl.cli.commands.recordings.why import FoundIncident, as_object
from robotctl.cli.ui.output import progress_bar
from robotctl.cli.ui.text import duration, size
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.names import EventKind
from robotctl.show.page import CommandVerdict, Explanation, ReportFindings, Tone
from robotctl.show.traces import Recorded

MAX_EXPLAINED: Final = 5
"""How many incidents are explained at most: each explanation reads the journal once."""

MAX_SENTENCES: Final = 20

_CHECK_TONES: Final = {Verdict.SAME: Tone.GOOD, Verdict.INCOMPLETE: Tone.UNSURE}
_VERIFY_TONES: Final = {"sealed": Tone.GOOD, "whole": Tone.UNSURE}
_ROWS: Final = ("came_in", "known", "rule", "asked", "went_out", "since")


def judge(path: Path, recorded: Recorded, *, quiet: bool) -> ReportFindings:
    """Check, verify and explain a recording; without a journal, only verify its bytes."""
    judgements, explanations = [], []
    if recorded.has_journal:
        with progress_bar("checking", quiet=quiet) as on_progress:
            (checked,) = check_recordings([path], on_progress)
        judgements.append(_checked(checked))
        explanations = _explained(path, recorded, quiet=quiet)
    judgements.append(_verified(verify_together([path], quiet=quiet)["recordings"][0]))
    return ReportFindings(tuple(judgements), tuple(explanations))


def _checked(report: dict[str, Any]) -> CommandVerdict:
    verdict = Verdict(report["verdict"])
    sentences = list(_check_sentences(report))
    return CommandVerdict(
        "replay --check",
        verdict.value,
        _CHECK_TONES.get(verdict, Tone.BAD),
        tuple(sentences[:MAX_SENTENCES]),
    )


def _check_sentences(report: dict[str, Any]) -> Iterator[str]:
    if report["events"]:
        how = "bit for bit" if report["bitwise"] else "as far as they can be compared"
        yield (
            f"{duration(report['duration_s'])}: {report['events']} events, "
            f"{report['effects']} effects compared {how}, {report['commands']} commands"
        )
    found = report["divergence"]
    if found is not None:
        yield f"first difference {found['after_s']:.3f} s after the beginning, at {found['event']}"
        yield f"recorded: {found['recorded'] or 'nothing'}"
        yield f"decided: {found['decided'] or 'nothing'}"
    for each in report["violations"]:
        yield f"{each['after_s']:.3f} s after the beginning: {each['text']}"
    yield from (f"not checked: {sentence}" for sentence in report["missing"])
    yield from (f"note: {sentence}" for sentence in report["notes"])
    if report["seal"]:
        yield f"seal: {report['seal']}"


def _verified(report: dict[str, Any]) -> CommandVerdict:
    sentences = [
        f"{file['name']}: {size(file['bytes'])}, {file['messages']} messages, {file['state']}"
        + (f", seal: {file['seal']['state']}" if file["seal"]["links"] else "")
        for file in report["files"]
    ]
    sentences += [f"wrong: {sentence}" for sentence in report["wrong"]]
    sentences += [f"not read: {sentence}" for sentence in report["unreadable"]]
    sentences += [f"note: {sentence}" for sentence in report["notes"]]
    verdict = report["verdict"]
    tone = _VERIFY_TONES.get(verdict, Tone.BAD)
    return CommandVerdict("verify", verdict, tone, tuple(sentences[:MAX_SENTENCES]))


def _explained(path: Path, recorded: Recorded, *, quiet: bool) -> list[Explanation]:
    """Explain the last incident and the last emergency stops and errors, in order of time."""
    stops = (EventKind.EMERGENCY_STOP, EventKind.ERROR)
    times = [event.log_ns for event in recorded.info.events if event.kind in stops]
    found: dict[int, Explanation] = {}
    for at_ns in (None, *times[::-1][: MAX_EXPLAINED - 1]):
        with progress_bar("reading the journal", quiet=quiet) as on_progress:
            try:
                incident = find_incident(path, at_ns, on_progress).incident
            except UnreadableFile:  # the verdicts name what cannot be read
                incident = None
        if incident is None or incident.seq in found:
            continue
        told = as_object(FoundIncident(path, incident, (), ()))
        t_s = (incident.log_ns - recorded.info.start_ns) / NS_PER_S
        rows = [
            (key.replace("_", " "), "; ".join(told[key]) if key == "went_out" else told[key])
            for key in _ROWS
        ]
        shown = tuple((label, text) for label, text in rows if text)
        found[incident.seq] = Explanation(t_s, told["what"], shown)
    return [found[seq] for seq in sorted(found)]
