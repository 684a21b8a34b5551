"""Re-run the decisions of a recording: unchanged, with other parameters, or with a simulation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotctl.base.errors import Divergence, RobotctlError, UnreadableFile, UsageError
from robotctl.check.closed_loop import resimulate
from robotctl.check.report import Verdict
from robotctl.check.run import check_recordings
from robotctl.check.what_if import check_scope, parse_settings, what_if
from robotctl.cli.targets.recordings import (
    LABEL_WIDTH,
    select_recordings,
    skipped_lines,
)
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import duration, number, printable, row, short_path
from robotctl.kernel.modes import Mode

_INDENT = " " * LABEL_WIDTH


def check_command(
    files: Sequence[Path], robot: str | None, *, all_bytes: bool, as_json: bool
) -> None:
    """Check recordings and print the results; files that are not recordings are skipped.

    With `all_bytes` every byte of large recordings is read, too.

    Raises:
        Divergence: A re-run decides differently, or a promise of docs/replay.md is broken.
        UnreadableFile: A recording could not be checked completely.
    """
    paths, skipped = select_recordings(files, robot, also_urls=True)
    with progress_bar("checking", quiet=as_json) as on_progress:
        reports = check_recordings(paths, on_progress, all_bytes=all_bytes)
    lines = [line for report in reports for line in report_lines(report)]
    lines += skipped_lines(skipped)
    answer = {"recordings": reports, **_counts(reports), "skipped": list(map(str, skipped))}
    print_answer(answer, lines, as_json=as_json, error=_gravest(reports))


def report_lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of `replay --check` for a recording; `report` is its JSON object."""
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


_LABEL_WIDTH, _COLUMN_WIDTH = 26, 14


def compare_command(
    files: Sequence[Path],
    settings: Sequence[str],
    robot: str | None,
    *,
    resim: bool,
    as_json: bool,
) -> None:
    """Re-run each recording with changed parameters, and print what differs, as tables or JSON.

    `settings` are texts KEY=VALUE; so is each of `files` that has an equals sign and does not
    exist. With `resim`, a simulated robot repeats the drives: `settings` may then also change that
    robot and `rate_hz`.

    Raises:
        UsageError: A setting is not allowed, or no recording is given.
        UnreadableFile: A recording could not be read completely.
    """
    more = [str(file) for file in files if "=" in file.name and not file.exists()]
    files = [file for file in files if str(file) not in more]
    if not files:
        raise UsageError("give a recording: robotctl replay FILE --what-if KEY=VALUE")
    parsed = parse_settings([*settings, *more])
    check_scope(parsed, closed_loop=resim)
    found = []
    paths, skipped = select_recordings(files, robot)
    for path in paths:
        with progress_bar(short_path(path), quiet=as_json) as on_progress:
            found.append((resimulate if resim else what_if)(path, parsed, on_progress))
        if not as_json:
            lines = resim_lines(found[-1]) if resim else what_if_lines(found[-1])
            print("\n".join(lines), flush=True)
    if skipped and not as_json:
        print("\n".join(skipped_lines(skipped)), flush=True)
    incomplete = sum(bool(each["missing"]) for each in found)
    why = f"{incomplete} of {len(found)} recordings could not be read completely"
    error = UnreadableFile(why) if incomplete else None
    if as_json:
        answer = {"recordings": found, "skipped": list(map(str, skipped))}
        print_answer(answer, (), as_json=True, error=error)
    elif error is not None:
        raise error


def settings_lines(settings: Mapping[str, Mapping[str, object]]) -> list[str]:
    """Return a table with the recorded and the changed value of each setting."""
    rows = (
        table_row(key, [printable(values[side]) for side in ("recorded", "what_if")])
        for key, values in settings.items()
    )
    return ["", table_row("", ["recorded", "what if"]), *rows]


def table_row(label: str, cells: Sequence[str]) -> str:
    """Return a row of a table as text: the label, then the right-aligned cells."""
    columns = "".join(f"{cell:>{_COLUMN_WIDTH}}" for cell in cells)
    return f"  {label:{_LABEL_WIDTH}}{columns}".rstrip()


def missing_lines(found: Mapping[str, Any]) -> list[str]:
    """Return the lines about the unreadable parts of a recording."""
    return [line for each in found["missing"] for line in row("  ", f"missing: {each}")]


OPEN_LOOP = (
    "  The robot does not react here: the measurements stay as recorded.\n"
    "  To see how it would have driven, use --resim."
)


def what_if_lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of `replay --what-if` for a recording; `found` is its JSON object."""
    yield f"{short_path(found['path'])}, {duration(found['duration_s'])}"
    yield OPEN_LOOP
    yield from settings_lines(found["settings"])
    for mode, seconds in found["modes_s"].items():
        if any(seconds.values()):
            yield table_row(
                f"in {mode}", [f"{seconds[side]:.2f} s" for side in ("recorded", "what_if")]
            )
    for side, label in (("recorded", "recorded"), ("what_if", "what if")):
        if found["no_drive"][side]:
            yield from row(f"  {label:11}", f"no such drive: {found['no_drive'][side]}")
    yield ""
    yield table_row("difference of commands", ["RMS", "at most", "at"])
    for key, label in (("linear_mps", "linear [m/s]"), ("angular_rps", "angular [rad/s]")):
        apart = found[key]
        at = "" if apart["max_after_s"] is None else f"{apart['max_after_s']:.3f} s"
        yield table_row(label, [f"{apart['rms']:.4g}", f"{apart['max']:.4g}", at])
    first = found["first_difference"]
    if first is None:
        yield "  no decision differs"
    else:
        yield f"  first difference after {first['after_s']:.3f} s"
        yield from row("    event     ", first["event"])
        yield from row("    recorded  ", "; ".join(first["recorded"]) or "nothing")
        yield from row("    what if   ", "; ".join(first["what_if"]) or "nothing")
    if found["mode_differs_s"]:
        yield f"  the modes differ for {duration(found['mode_differs_s'])}"
    for answer in found["answers"]:
        moment = f"after {answer['after_s']:.3f} s"
        yield f"  request {answer['request_id']} {moment} gets another answer"
        yield from row("    recorded  ", answer["recorded"])
        yield from row("    what if   ", answer["what_if"])
    more = found["answer_count"] - len(found["answers"])
    if more:
        yield f"  and {more} more requests"
    yield from missing_lines(found)


_FIGURES = {
    "laps": ("laps", "d"),
    "duration_s": ("duration [s]", ".2f"),
    "distance_m": ("distance [m]", ".3f"),
    "cross_track_rms_m": ("off track RMS [m]", ".4f"),
    "cross_track_max_m": ("off track max [m]", ".4f"),
    "closure_m": ("closure [m]", ".4f"),
}
_SIDES = {"recorded": "recorded", "simulated": "simulated", "what_if": "what if"}


def resim_lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of `replay --resim` for a recording; `found` is its JSON object."""
    yield f"{short_path(found['path'])}, {duration(found['duration_s'])}"
    yield "  Simulated: the recorded parameters and requests, with a simulated robot."
    sides = [side for side in _SIDES if side != "what_if" or found["settings"]]
    if found["settings"]:
        yield from settings_lines(found["settings"])
    if not found["drives"]:
        yield "  no such drive: no motion was requested"
    for drive in found["drives"]:
        yield ""
        yield table_row(f"drive {drive['request_id']}", [_SIDES[side] for side in sides])
        for figure, (label, form) in _FIGURES.items():
            values = [(drive[side] or {}).get(figure) for side in sides]
            if any(value is not None for value in values):
                yield table_row(
                    label, ["" if value is None else number(value, form) for value in values]
                )
        for side in sides:
            ended = drive[side]
            told = ended["reason"] if ended else f"no such drive: {drive['no_drive'][side]}"
            yield from row(f"  {_SIDES[side]:11}", told)
    yield from missing_lines(found)
