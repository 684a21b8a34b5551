"""plot: fields of a recorded topic over time, in the terminal or as a picture."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Final

import typer

from robotctl.cli.options import new_app
from robotctl.cli.support.recording_paths import RecordedBy, RecordingsFolder, find_recording
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import can_show_braille, is_terminal, printable, short_path
from robotctl.errors import RecoveredWithLoss, Refused, UsageError

if TYPE_CHECKING:
    from robotctl.report.field_series import FieldSeries

app = new_app()

PNG, SVG = ".png", ".svg"
WIDTH, HEIGHT = 80, 23
"""The size of the picture without a terminal."""

MAX_WIDTH: Final = 300


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

    A message stands for its numbers, as in pose.pose.position. Without FIELD the numbers of the
    topic are named. `export` writes the numbers themselves. Needs neither ROS nor a daemon.

    \b
    Examples:
      robotctl plot last /odom pose.pose.position.x twist.twist.linear.x
      robotctl plot last /battery_state percentage
      robotctl plot run.mcap /scan ranges[0] -o scan.png
    """
    if output is not None and output.suffix not in (PNG, SVG):
        raise UsageError(f"-o {output}", f"give a name that ends in {PNG} or {SVG}")
    from robotctl.recording import Recording
    from robotctl.recording.table.topic_choice import choose_topic
    from robotctl.report.field_series import number_fields, read_fields

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
    from robotctl.cli.terminal.field_picture import field_lines

    width, height = WIDTH, HEIGHT
    if is_terminal():
        terminal = shutil.get_terminal_size((WIDTH, HEIGHT + 1))
        width, height = min(terminal.columns, MAX_WIDTH), terminal.lines - 1
    return field_lines(
        found,
        duration_s,
        width=width,
        height=height,
        colour=is_terminal() and not os.environ.get("NO_COLOR"),
        ascii_only=not can_show_braille(),
    )


def _write(target: Path, found: Sequence[FieldSeries], duration_s: float) -> None:
    from robotctl.recording.disk.replaced_file import replaced_file

    try:
        with replaced_file(target) as stream:
            _draw(stream, target.suffix, found, duration_s)
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror or error}") from error


def _draw(stream: IO[bytes], suffix: str, found: Sequence[FieldSeries], duration_s: float) -> None:
    if suffix == PNG:
        from robotctl.report.field_png import write_fields_png

        write_fields_png(stream, found, duration_s)
    else:
        from robotctl.report.field_svg import fields_svg

        stream.write(fields_svg(found, duration_s).encode())


def _left_out(found: Sequence[FieldSeries]) -> Iterator[str]:
    for each in found:
        if each.series.odd:
            yield f"{each.path}: {each.series.odd} values are no finite numbers, or above 1e15"
        if each.absent:
            yield f"{each.path}: {each.absent} messages have a shorter list"
