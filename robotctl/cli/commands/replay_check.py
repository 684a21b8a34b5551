"""replay --check: recordings decided once more, and what came of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.support.answer import tell
from robotctl.cli.support.recording_paths import find_recording
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import duration, row, short_path
from robotctl.errors import Divergence, RobotctlError, UnreadableFile
from robotctl.kernel.modes import Mode
from robotctl.recording.read.files import is_recording
from robotctl.rerun.check_many import check_recordings
from robotctl.rerun.check_report import Verdict

_WIDTH = 12
_INDENT = " " * _WIDTH


def check_command(files: Sequence[Path], robot: str | None, *, as_json: bool) -> None:
    """Check recordings and say what came of it; other files that a shell's glob brings are skipped.

    Raises:
        Divergence: One of them decides otherwise, or breaks a promise.
        UnreadableFile: Not all of them could be checked whole.
    """
    paths, others = recordings_among(files, robot)
    with progress_bar("checking", quiet=as_json) as on_progress:
        reports = check_recordings(paths, on_progress)
    lines = [line for report in reports for line in report_lines(report)]
    lines += skipped_lines(others)
    answer = {"recordings": reports, **_counts(reports), "skipped": list(map(str, others))}
    tell(answer, lines, as_json=as_json, error=_gravest(reports))


def report_lines(report: dict[str, Any]) -> Iterator[str]:
    """What came of one check, from its object in `--json`."""
    verdict = Verdict(report["verdict"])
    yield f"{verdict.value:{_WIDTH}}{short_path(report['path'])}"
    if report["events"]:
        how = "bit for bit" if report["bitwise"] else "as far as they can be compared"
        yield from row(
            _INDENT,
            f"{duration(report['duration_s'])}: {report['events']} events, "
            f"{report['effects']} effects compared {how}, {report['commands']} commands",
        )
    found = report["divergence"]
    if found is not None:
        yield from _divergence_lines(found)
    for each in report["violations"]:
        yield from row(_INDENT, f"{_moment(each)}: {each['text']}")
    more = report["violation_count"] - len(report["violations"])
    if more:
        yield from row(_INDENT, f"and {more} more")
    for sentence in report["missing"]:
        yield from row(_INDENT, f"not checked: {sentence}")
    for sentence in report["notes"]:
        yield from row(_INDENT, f"note: {sentence}")


def _divergence_lines(found: dict[str, Any]) -> Iterator[str]:
    yield from row(_INDENT, f"first at entry {found['seq']}, {_moment(found)}")
    rows = {
        "before": _state_text(found["state"]),
        "event": found["event"],
        "recorded": found["recorded"] or "nothing",
        "decided": found["decided"] or "nothing",
        "differs": "; ".join(found["differences"]),
    }
    for label, text in rows.items():
        if text:
            yield from row(f"{_INDENT}  {label:9}", text)


def _moment(found: dict[str, Any]) -> str:
    clock = f", at {found['at'][11:23]}" if found["at"] else ""
    return f"{found['after_s']:.3f} s after the beginning{clock}"


def _state_text(state: dict[str, Any] | None) -> str:
    if state is None:
        return ""
    command, drive = state["command"], state["drive"]
    pattern = f" a {drive['pattern']['kind']}" if drive else ""
    return (
        f"{Mode(state['mode']).name}, {state['phase']}{pattern}, "
        f"command {command['linear']:.4g} m/s, {command['angular']:.4g} rad/s"
    )


def _counts(reports: Sequence[dict[str, Any]]) -> dict[str, int]:
    return {verdict.value: sum(r["verdict"] == verdict for r in reports) for verdict in Verdict}


def _gravest(reports: Sequence[dict[str, Any]]) -> RobotctlError | None:
    found = {verdict: [r for r in reports if r["verdict"] == verdict] for verdict in Verdict}
    of = f" of {len(reports)} recordings" if len(reports) > 1 else " recording"
    if found[Verdict.DIVERGED]:
        return Divergence(
            f"{len(found[Verdict.DIVERGED])}{of} would be decided differently by this robotctl"
        )
    if found[Verdict.BROKEN]:
        return Divergence(f"{len(found[Verdict.BROKEN])}{of} breaks a promise of robotctl")
    if found[Verdict.INCOMPLETE]:
        return UnreadableFile(f"{len(found[Verdict.INCOMPLETE])}{of} could not be checked whole")
    return None


def recordings_among(files: Sequence[Path], robot: str | None) -> tuple[list[Path], list[Path]]:
    """The recordings that are meant by paths, names or `last`, and the paths that are none.

    Of a folder of recordings, all of them. Where no path is a recording, all count as recordings:
    each then has to say what is wrong with it. Raises Refused where there is no last one.
    """
    found = [find_recording(str(file), robot) for file in files]
    others = [path for path in found if not is_recording(path)]
    if len(others) == len(found):
        others = []
    return [each for path in found if path not in others for each in _recordings_at(path)], others


def skipped_lines(others: Sequence[Path]) -> list[str]:
    """A line for each path that is no recording."""
    return [f"{'skipped':{_WIDTH}}{short_path(path)}: it is no recording" for path in others]


def _recordings_at(path: Path) -> list[Path]:
    """The recording itself, or those in a folder of recordings."""
    try:
        if path.is_dir() and not any(path.glob("*.mcap")):
            return sorted({file.parent for file in path.glob("*/*.mcap")}) or [path]
    except OSError:
        pass  # its reader says why it cannot be read
    return [path]
