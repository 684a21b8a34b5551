"""replay --check: re-run the decisions of recordings, and compare them with the recorded ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.commands.replay.select_recordings import (
    LABEL_WIDTH,
    select_recordings,
    skipped_lines,
)
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import duration, row, short_path
from robotctl.errors import Divergence, RobotctlError, UnreadableFile
from robotctl.kernel.modes import Mode
from robotctl.rerun.check_many import check_recordings
from robotctl.rerun.check_report import Verdict

_INDENT = " " * LABEL_WIDTH


def check_command(
    files: Sequence[Path], robot: str | None, *, all_bytes: bool, as_json: bool
) -> None:
    """Check recordings and print the results; files that are not recordings are skipped.

    With `all_bytes` every byte of large recordings is read, too.

    Raises:
        Divergence: A recording is decided differently, or breaks a promise.
        UnreadableFile: A recording could not be checked completely.
    """
    paths, skipped = select_recordings(files, robot)
    with progress_bar("checking", quiet=as_json) as on_progress:
        reports = check_recordings(paths, on_progress, all_bytes=all_bytes)
    lines = [line for report in reports for line in report_lines(report)]
    lines += skipped_lines(skipped)
    answer = {"recordings": reports, **_counts(reports), "skipped": list(map(str, skipped))}
    print_answer(answer, lines, as_json=as_json, error=_gravest(reports))


def report_lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the result of one check, from its object in `--json`."""
    verdict = Verdict(report["verdict"])
    yield f"{verdict.value:{LABEL_WIDTH}}{short_path(report['path'])}"
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
    if report["seal"]:
        yield from row(_INDENT, f"seal: {report['seal']}")


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
    counts = _counts(reports)

    def those(verdict: Verdict) -> str:
        total = len(reports)
        return "the recording" if total == 1 else f"{counts[verdict]} of {total} recordings"

    if counts[Verdict.DIVERGED]:
        return Divergence(
            f"{those(Verdict.DIVERGED)} would be decided differently by this version of robotctl"
        )
    if counts[Verdict.BROKEN]:
        return Divergence(f"{those(Verdict.BROKEN)} broke a promise of robotctl")
    if counts[Verdict.INCOMPLETE]:
        return UnreadableFile(f"{those(Verdict.INCOMPLETE)} could not be checked completely")
    return None
