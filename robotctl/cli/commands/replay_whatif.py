"""replay --what-if and --resim: the same run with other parameters, as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.commands.replay_check import recordings_among, skipped_lines
from robotctl.cli.support.answer import tell
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import duration, number, printable, row, short_path
from robotctl.errors import UnreadableFile, UsageError
from robotctl.rerun.recorded_settings import check_scope, parse_settings
from robotctl.rerun.resim import resimulate
from robotctl.rerun.whatif import what_if

OPEN_LOOP = (
    "  The robot does not react here: these are other decisions on what was measured.\n"
    "  How it would have driven, a simulation tells: --resim."
)

_FIGURES = {
    "laps": ("laps", "d"),
    "duration_s": ("duration [s]", ".2f"),
    "distance_m": ("distance [m]", ".3f"),
    "cross_track_rms_m": ("off track RMS [m]", ".4f"),
    "cross_track_max_m": ("off track max [m]", ".4f"),
    "closure_m": ("closure [m]", ".4f"),
}
_SIDES = {"recorded": "recorded", "simulated": "simulated", "what_if": "what if"}
_LABEL, _COLUMN = 26, 14


def what_if_command(
    files: Sequence[Path],
    settings: Sequence[str],
    robot: str | None,
    *,
    closed_loop: bool,
    as_json: bool,
) -> None:
    """Compare recordings with what would come of other parameters.

    What stands among the files, names none and has an equals sign is one more setting.

    Raises:
        UsageError: A setting is not allowed, or there is none.
        UnreadableFile: A recording could not be read, or not all of it.
    """
    more = [str(file) for file in files if "=" in file.name and not file.exists()]
    files = [file for file in files if str(file) not in more]
    if not files:
        raise UsageError("give a recording: robotctl replay FILE --what-if KEY=VALUE")
    parsed = parse_settings([*settings, *more])
    check_scope(parsed, closed_loop=closed_loop)
    compare, lines = (resimulate, resim_lines) if closed_loop else (what_if, what_if_lines)
    found = []
    paths, others = recordings_among(files, robot)
    for path in paths:
        with progress_bar(short_path(path), quiet=as_json) as on_progress:
            found.append(compare(path, parsed, on_progress))
        if not as_json:
            print("\n".join(lines(found[-1])), flush=True)
    if others and not as_json:
        print("\n".join(skipped_lines(others)), flush=True)
    incomplete = [each for each in found if each["missing"]]
    error = None
    if incomplete:
        error = UnreadableFile(
            f"{len(incomplete)} of {len(found)} recordings: not everything could be read"
        )
    if as_json:
        tell(
            {"recordings": found, "skipped": list(map(str, others))}, (), as_json=True, error=error
        )
    elif error is not None:
        raise error


def what_if_lines(found: dict[str, Any]) -> Iterator[str]:
    """The tables of an open loop, from its object in `--json`."""
    yield f"{short_path(found['path'])}, {duration(found['duration_s'])}"
    yield OPEN_LOOP
    yield from _settings_lines(found["settings"])
    for mode, seconds in found["modes_s"].items():
        if any(seconds.values()):
            yield _table_row(
                f"in {mode}", [f"{seconds[side]:.2f} s" for side in ("recorded", "what_if")]
            )
    yield ""
    yield _table_row("difference of commands", ["RMS", "at most", "at"])
    for key, label in (("linear_mps", "linear [m/s]"), ("angular_rps", "angular [rad/s]")):
        apart = found[key]
        at = "" if apart["max_after_s"] is None else f"{apart['max_after_s']:.3f} s"
        yield _table_row(label, [f"{apart['rms']:.4g}", f"{apart['max']:.4g}", at])
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
        yield f"  request {answer['request_id']} {moment} is answered otherwise"
        yield from row("    recorded  ", answer["recorded"])
        yield from row("    what if   ", answer["what_if"])
    more = found["answer_count"] - len(found["answers"])
    if more:
        yield f"  and {more} more requests"
    yield from _missing_lines(found)


def resim_lines(found: dict[str, Any]) -> Iterator[str]:
    """The tables of a closed loop, from its object in `--json`."""
    yield f"{short_path(found['path'])}, {duration(found['duration_s'])}"
    yield "  Simulated: the recorded parameters and requests, a robot of the model."
    sides = [side for side in _SIDES if side != "what_if" or found["settings"]]
    if found["settings"]:
        yield from _settings_lines(found["settings"])
    if not found["drives"]:
        yield "  no drive"
    for drive in found["drives"]:
        yield ""
        yield _table_row(f"drive {drive['request_id']}", [_SIDES[side] for side in sides])
        for figure, (label, form) in _FIGURES.items():
            values = [(drive[side] or {}).get(figure) for side in sides]
            if any(value is not None for value in values):
                yield _table_row(
                    label, ["" if value is None else number(value, form) for value in values]
                )
        for side in sides:
            ended = drive[side]
            yield from row(f"  {_SIDES[side]:11}", ended["reason"] if ended else "no such drive")
    yield from _missing_lines(found)


def _settings_lines(settings: Mapping[str, Mapping[str, object]]) -> Iterator[str]:
    yield ""
    yield _table_row("", ["recorded", "what if"])
    for key, values in settings.items():
        yield _table_row(key, [printable(values[side]) for side in ("recorded", "what_if")])


def _table_row(label: str, cells: Sequence[str]) -> str:
    return f"  {label:{_LABEL}}{''.join(f'{cell:>{_COLUMN}}' for cell in cells)}".rstrip()


def _missing_lines(found: Mapping[str, Any]) -> Iterator[str]:
    for sentence in found["missing"]:
        yield from row("  ", f"missing: {sentence}")
