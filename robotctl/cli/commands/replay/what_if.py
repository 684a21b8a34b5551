"""replay --what-if: re-run recorded decisions with other parameters, on the same inputs."""

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
from robotctl.cli.terminal.text import duration, row, short_path
from robotctl.rerun.whatif import what_if

OPEN_LOOP = (
    "  The robot does not react here: the measurements stay as recorded.\n"
    "  To see how it would have driven, use --resim."
)


def what_if_command(
    files: Sequence[Path], settings: Sequence[str], robot: str | None, *, as_json: bool
) -> None:
    """Print how decisions with other parameters differ.

    Raises:
        UsageError: A setting is not allowed.
        UnreadableFile: A recording could not be read completely.
    """
    compare_settings(
        files, settings, robot, what_if, what_if_lines, closed_loop=False, as_json=as_json
    )


def what_if_lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the tables of one recording, from its object in `--json`."""
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
