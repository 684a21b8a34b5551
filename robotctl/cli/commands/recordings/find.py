"""index, find: write an index of each recording, and query all indexes together."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import open_catalogue
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import columns, elided, moment, printable, row, short_path, size
from robotctl.kernel.constants import NS_PER_S

if TYPE_CHECKING:
    from robotctl.collection.questions import Answer


app = new_app()

SHOWN = {
    "drives": ("recording", "drive", "pattern", "laps", "max_error_m", "ended"),
    "recordings": ("recording", "duration_s", "laps", "stops", "max_error_m", "check", "verify"),
    "events": ("recording", "start_ns", "event", "text"),
    "topics": ("recording", "topic", "messages", "lost", "rate_hz"),
}
"""The columns of each table in the text; `--json` has all."""

LEAST_WIDTH = 10

AROUND_DRIVE_S: Final = (2.0, 2.0)
AROUND_EVENT_S: Final = (30.0, 5.0)
"""The time in a clip before and after a drive, and before and after an event [s]."""

DISPLAYS: Final = ("DISPLAY", "WAYLAND_DISPLAY")


class OpenAs(StrEnum):
    """The command that `find --open` runs for a row that was found."""

    REPORT = "report"
    CLIP = "clip"


@app.command()
def find(
    condition: Annotated[
        str,
        typer.Argument(help="Such as 'laps >= 1 and max_error_m > 0.1' [default: every row]."),
    ] = "",
    folder: Annotated[
        str | None,
        typer.Option(
            "--in",
            metavar="DIR",
            help="A folder of recordings [default: ./recordings, or the daemon's, or the last "
            "daemon's].",
        ),
    ] = None,
    recordings: Annotated[
        bool, typer.Option("--recordings", help="A row per recording, not per drive.")
    ] = False,
    events: Annotated[
        bool, typer.Option("--events", help="A row per change of mode, refusal, stop or mark.")
    ] = False,
    topics: Annotated[bool, typer.Option("--topics", help="A row per topic of a recording.")] = (
        False
    ),
    sort: Annotated[
        str,
        typer.Option(
            metavar="COLUMN", help="Sort by it; -COLUMN: the largest first [default: by time]."
        ),
    ] = "",
    limit: Annotated[int, typer.Option(min=0, help="The most rows that are shown; 0: all.")] = 0,
    sql: Annotated[
        str | None,
        typer.Option(
            "--sql",
            metavar="QUERY",
            help="Ask in SQL: tables recordings, drives, events, topics, samples.",
        ),
    ] = None,
    open_row: Annotated[
        int | None, typer.Option("--open", metavar="N", help="Open row N of the answer.")
    ] = None,
    open_kind: Annotated[
        OpenAs, typer.Option("--as", help="How to open it, at its moment.")
    ] = OpenAs.REPORT,
    as_json: Json = False,
) -> None:
    """Find drives in many recordings by a condition.

    Answers come from the indexes (see `robotctl index`), which are made first where they are
    missing or old. The condition compares columns with < <= == != >= >, and joins them with
    and, or, not. `--json` shows all columns. Needs the extra robotctl[parquet].

    `--open N` does for row N what `report` or `clip` does, and prints what that prints: where
    the page or the clip is. A browser shows the page at the moment if
    there is a display.

    \b
    Examples:
      robotctl find "laps >= 1 and max_error_m > 0.1"
      robotctl find "check != 'same'" --recordings --in /data/robots
      robotctl find --sort -max_error_m --limit 3 --json
      robotctl find --sort -max_error_m --open 1
      robotctl find "mode == 'EMERGENCY_STOP'" --events --open 2 --as clip
      robotctl find --sql "SELECT cause, count(*) FROM drives GROUP BY cause"
    """
    wanted = [
        name
        for name, is_wanted in (("recordings", recordings), ("events", events), ("topics", topics))
        if is_wanted
    ]
    if len(wanted) > 1:
        raise UsageError(f"--{wanted[0]} and --{wanted[1]} are two tables", "give one of them")
    table = wanted[0] if wanted else "drives"
    if sql is not None and (condition or wanted):
        raise UsageError("--sql is a whole question", "leave the condition and the table out")
    from robotctl.collection.questions import ask
    from robotctl.collection.questions import find as find_rows

    with open_catalogue(folder, quiet=as_json) as (place, catalogue):
        if sql is not None:
            found = ask(catalogue, sql)
        else:
            found = find_rows(catalogue, table, condition, sort, limit)
    left_out = catalogue.left_out
    if not as_json:
        for sentence in left_out:
            print(f"robotctl: {sentence}", file=sys.stderr)
    if open_row is not None:
        _open(found.as_objects(), open_row, place, open_kind, as_json=as_json)
        return
    shown = found.columns if sql is not None else SHOWN[table]
    answer = {"rows": found.as_objects(), "left_out": left_out}
    print_answer(answer, _lines(found, shown), as_json=as_json)


def _lines(found: Answer, shown: tuple[str, ...]) -> Iterator[str]:
    places = [found.columns.index(each) for each in shown]
    width = columns()
    table = [
        (list(shown[:-1]), shown[-1]),
        *(
            ([elided(each, width // 3) for each in texts[:-1]], texts[-1])
            for values in found.rows
            for texts in [[_text(found.columns[each], values[each]) for each in places]]
        ),
    ]
    widths = [max(len(cells[number]) for cells, _ in table) for number in range(len(shown) - 1)]
    for cells, last in table:
        label = "".join(f"{cell:{wide}}  " for cell, wide in zip(cells, widths, strict=True))
        wraps = len(label) + LEAST_WIDTH <= width < len(label) + len(last)
        yield from row(label, last) if wraps else [f"{label}{last}"]
    yield f"{len(found.rows)} row{'' if len(found.rows) == 1 else 's'}"


def _text(column: str, value: Any) -> str:
    if value is None:
        return "-"
    if column == "start_ns":
        return moment(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    return printable(str(value))


def _open(
    rows: list[dict[str, Any]], number: int, folder: Path, kind: OpenAs, *, as_json: bool
) -> None:
    """Run `report` or `clip` on the recording of row `number`, at the row's time.

    The first row is 1. The page opens in a browser if stdout is a terminal with a display.

    Raises:
        Refused: There is no such row, or its recording does not exist any more.
        UsageError: The row names no recording, or has no time for a clip.
        RobotctlError: The command failed.
    """
    if not 1 <= number <= len(rows):
        raise Refused(f"there is no row {number}: the answer has {len(rows) or 'none'}")
    about = rows[number - 1]
    if not isinstance(about.get("recording"), str):
        raise UsageError("--open needs the column recording", "add it to the query")
    path = folder / Path(about["recording"]).name
    if not path.exists():
        raise Refused(f"{path} does not exist any more")
    at_s = _offset_s(path, about)
    if kind is OpenAs.CLIP:
        from robotctl.cli.commands.recordings.clip import clip

        if at_s is None:
            raise UsageError("the row has no moment to clip", "ask for drives, or for --events")
        is_drive = "drive" in about
        before_s, after_s = AROUND_DRIVE_S if is_drive else AROUND_EVENT_S
        after_s += (about.get("duration_s") or 0.0) if is_drive else 0.0
        clip(str(path), at=f"{at_s:.3f}", before=before_s, after=after_s, as_json=as_json)
        return
    from robotctl.cli.commands.recordings.report import page_of, report

    report(str(path), as_json=as_json)
    if sys.stdout.isatty() and any(map(os.environ.get, DISPLAYS)):
        import webbrowser

        webbrowser.open(f"{page_of(path).absolute().as_uri()}#t={at_s or 0.0:.3f}")


def _offset_s(path: Path, about: Mapping[str, Any]) -> float | None:
    """Return the start of the row `about` [s into its recording], None if it has no time."""
    from robotctl.recording import read_info

    start_ns = about.get("start_ns")
    if not isinstance(start_ns, int) or "drives" in about:
        return None
    return max(start_ns - read_info(path).start_ns, 0) / NS_PER_S


@app.command()
def index(
    folder: Annotated[
        str | None,
        typer.Argument(
            metavar="[DIR]",
            help="A folder of recordings [default: ./recordings, or the daemon's, or the last "
            "daemon's].",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Make the index beside each recording that has none, or an old one.

    An index is a small Parquet file: drives, events, losses, rates, parameters, samples of pose
    and command, and the verdicts of `replay --check` and `verify`. `find` answers from it. Needs
    the extra robotctl[parquet]; needs neither ROS nor a daemon. The exit code is 6 if a recording
    could not be indexed.

    \b
    Examples:
      robotctl index
      robotctl index /data/robots --json
    """
    with open_catalogue(folder, quiet=as_json) as (place, catalogue):
        bytes_of = [os.stat(each).st_size for each in catalogue.indexes]
        answer = {
            "folder": str(place),
            "indexed": len(catalogue.indexes),
            "bytes": sum(bytes_of),
            "left_out": list(catalogue.left_out),
            "failures": {str(path): said for path, said in catalogue.failures.items()},
        }
    counted = "1 recording has" if len(bytes_of) == 1 else f"{len(bytes_of)} recordings have"
    lines = [
        f"{short_path(place)}: {counted} an index, {size(sum(bytes_of))}",
        *catalogue.left_out,
    ]
    failed = len(catalogue.failures)
    error = UnreadableFile(f"{failed} recordings could not be indexed") if failed else None
    print_answer(answer, lines, as_json=as_json, error=error)
