"""replay --resim: re-run recorded drives with a simulated robot, on virtual time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robotctl.cli.commands.replay.compare_settings import (
    compare_settings,
    missing_lines,
    settings_lines,
    table_row,
)
from robotctl.cli.terminal.text import duration, number, row, short_path
from robotctl.rerun.resim import resimulate

_FIGURES = {
    "laps": ("laps", "d"),
    "duration_s": ("duration [s]", ".2f"),
    "distance_m": ("distance [m]", ".3f"),
    "cross_track_rms_m": ("off track RMS [m]", ".4f"),
    "cross_track_max_m": ("off track max [m]", ".4f"),
    "closure_m": ("closure [m]", ".4f"),
}
_SIDES = {"recorded": "recorded", "simulated": "simulated", "what_if": "what if"}


def resim_command(
    files: Sequence[Path], settings: Sequence[str], robot: str | None, *, as_json: bool
) -> None:
    """Print the recorded and the simulated drives.

    Raises:
        UsageError: A setting is not allowed.
        UnreadableFile: A recording could not be read completely.
    """
    compare_settings(
        files, settings, robot, resimulate, resim_lines, closed_loop=True, as_json=as_json
    )


def resim_lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the tables of one recording, from its object in `--json`."""
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
