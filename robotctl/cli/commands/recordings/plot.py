"""plot: fields of a recorded topic over time, in the terminal or as a picture."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from robotctl.base.errors import RecoveredWithLoss, Refused, UsageError
from robotctl.cli.options import new_app
from robotctl.cli.targets.recordings import RecordedBy, RecordingsFolder, find_recording
from robotctl.cli.ui.output import progress_bar
from robotctl.cli.ui.text import can_show_braille, elided, is_terminal, printable, short_path

if TYPE_CHECKING:
    from robotctl.show.series import FieldSeries

app = new_app()

PNG, SVG = ".png", ".svg"
WIDTH, HEIGHT = 80, 23
"""The size of the text figures without a terminal [columns, lines]."""

MAX_WIDTH: Final = 300
LEAST_ROWS: Final = 4
OTHER_LINES: Final = 2
"""The lines of a field in addition to its rows: its name, and the time axis."""


@app.command()
def plot(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="An MCAP file, a recording's folder or name, or `last`."
        ),
    ],
    topic: Annotated[str, typer.Argument(metavar="TOPIC", help="The topic, such as /odom.")],
    fields: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FIELD...", help="Numbers, such as pose.pose.position.x or ranges[3]."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PICTURE", help="Write a file, .png or .svg."),
    ] = None,
    type_name: Annotated[
        str, typer.Option("--type", metavar="TYPE", help="The type, where the topic has several.")
    ] = "",
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
) -> None:
    """Draw fields of a topic over time, here or as a picture.

    A FIELD that is a message, as pose.pose.position, means all its numbers. Without FIELD, the
    names of the numbers are listed; `export` writes their values. Needs neither ROS nor a daemon.

    \b
    Examples:
      robotctl plot last /odom pose.pose.position.x twist.twist.linear.x
      robotctl plot last /battery_state percentage
      robotctl plot run.mcap /scan ranges[0] -o scan.png
    """
    if output is not None and output.suffix not in (PNG, SVG):
        raise UsageError(f"-o {output}", f"give a name that ends in {PNG} or {SVG}")
    from robotctl.recording import Recording
    from robotctl.recording.table import choose_topic
    from robotctl.show.series import number_fields, read_fields

    source = find_recording(file, robot, folder)
    with Recording(source) as recording:
        info = recording.info()
        listing = f"robotctl topic list --file {file}"
        chosen = choose_topic(info, topic, type_name, listing=listing)
        wanted = number_fields(chosen, fields or ())
        missing = list(info.missing)
        with progress_bar("reading", quiet=False) as on_progress:
            found = read_fields(recording, chosen, wanted, missing.append, on_progress)
    if output is None:
        print("\n".join(_lines(found, info.duration_s)))
    else:
        _write(output, found, info.duration_s)
        print(short_path(output))
    missing += _left_out(found)
    if missing:
        raise RecoveredWithLoss(f"not all is drawn: {'; '.join(map(printable, missing))}")


def _lines(found: Sequence[FieldSeries], duration_s: float) -> Iterator[str]:
    """Yield the figures one below the other; together they fill the terminal if they fit in it."""
    from robotctl.show.terminal import LABEL, time_lines

    width, height = WIDTH, HEIGHT
    if is_terminal():
        terminal = shutil.get_terminal_size((WIDTH, HEIGHT + 1))
        width, height = min(terminal.columns, MAX_WIDTH), terminal.lines - 1
    rows = max(height // max(len(found), 1) - OTHER_LINES, LEAST_ROWS)
    colour, ascii_only = is_terminal() and not os.environ.get("NO_COLOR"), not can_show_braille()
    for each in found:
        yield elided(f"{'':{LABEL}} {each.path}  {_range(each)}", width)
        figure = each.figure(duration_s)
        yield from time_lines(figure, width=width, rows=rows, colour=colour, ascii_only=ascii_only)


def _range(field: FieldSeries) -> str:
    series = field.series
    if series.least is None or series.most is None:
        return "no values"
    return f"{series.least:.6g} to {series.most:.6g}, {series.count} values"


def _write(target: Path, found: Sequence[FieldSeries], duration_s: float) -> None:
    from robotctl.recording.disk import replaced_file

    figures = [each.figure(duration_s) for each in found]
    try:
        with replaced_file(target) as stream:
            if target.suffix == PNG:
                from robotctl.show.png import write_png

                write_png(stream, figures)
            else:
                from robotctl.show.svg import figures_svg

                stream.write(figures_svg(figures).encode())
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror or error}") from error


def _left_out(found: Sequence[FieldSeries]) -> Iterator[str]:
    for each in found:
        if each.series.odd:
            yield f"{each.path}: {each.series.odd} values are no finite numbers, or above 1e15"
        if each.absent:
            yield f"{each.path}: {each.absent} messages have a shorter list"
