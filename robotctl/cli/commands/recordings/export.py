"""export: the messages of a topic as CSV, JSON lines or Parquet."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robotctl.base.errors import RecoveredWithLoss, UsageError
from robotctl.cli.options import RecordingFile, new_app
from robotctl.cli.targets.driving import interrupted_by
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    find_recording,
    parse_moment,
)
from robotctl.cli.ui.output import Progress, print_answer, progress_bar
from robotctl.cli.ui.text import printable, short_path

if TYPE_CHECKING:
    from robotctl.recording.read.messages import Window
    from robotctl.recording.read.reader import RecordingInfo
    from robotctl.recording.table import Row, TopicTable

app = new_app()


class TableFormat(Enum):
    """The format of the exported table; the value is the file's suffix without the dot."""

    CSV = "csv"
    JSON = "json"
    PARQUET = "parquet"


_SUFFIXES = {f".{each.value}": each for each in TableFormat} | {
    ".jsonl": TableFormat.JSON,
    ".ndjson": TableFormat.JSON,
}

_PROGRESS_ROWS = 1_000


@app.command()
def export(
    file: RecordingFile,
    topic: Annotated[str, typer.Option(metavar="TOPIC", help="The topic, such as /odom.")],
    as_csv: Annotated[
        bool, typer.Option("--csv", help="CSV with a header [default, unless OUT says another].")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    as_parquet: Annotated[
        bool, typer.Option("--parquet", help="Parquet; needs -o and robotctl[parquet].")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="A new file [default: stdout]."),
    ] = None,
    begin: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="T",
            help="Only from then on: seconds into the recording, 12:03:04, or a date.",
        ),
    ] = None,
    end: Annotated[
        str | None, typer.Option("--to", metavar="T", help="Only up to then, as --from.")
    ] = None,
    type_name: Annotated[
        str, typer.Option("--type", metavar="TYPE", help="The type, where the topic has several.")
    ] = "",
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
) -> None:
    """Write the messages of a topic as a table: CSV, JSON lines or Parquet.

    Each field is a column, such as pose.pose.position.x, after the times of the message: log_ns,
    publish_ns, and time_s, the seconds into the recording.

    \b
    Examples:
      robotctl export last --topic /odom -o odom.csv
      robotctl export run.mcap --topic /odom --from 10 --to 20 -o odom.parquet
      robotctl export last --topic /robot_status --json | head
    """
    from robotctl.recording import Recording
    from robotctl.recording.table import TopicTable, choose_topic

    chosen = [
        each
        for each, given in zip(TableFormat, (as_csv, as_json, as_parquet), strict=True)
        if given
    ]
    form = _format(chosen, output)
    source = find_recording(file, robot, folder, also_url=True)
    with Recording(source) as recording:
        info = recording.info()
        chosen_topic = choose_topic(
            info, topic, type_name, listing=f"robotctl topic list --file {file}"
        )
        table = TopicTable(recording, chosen_topic)
        missing = list(info.missing)
        window = _window(begin, end, info)
        with progress_bar("exporting", quiet=output is None or as_json) as on_progress:
            rows = _told(table.rows(missing.append, window), on_progress, window, info)
            if output is None:
                count = _print(form, table, rows)
            else:
                with interrupted_by((signal.SIGTERM, signal.SIGHUP)):
                    count = _write(form, table, rows, output, source)
    loss = f"{source} could not be read completely: {'; '.join(missing)}"
    error = RecoveredWithLoss(loss) if missing else None
    if output is not None:
        columns = len(table.columns)
        answer = {"target": str(output), "rows": count, "columns": columns, "lost": missing}
        line = f"{short_path(output)}: {count} rows, {columns} columns"
        print_answer(answer, [line], as_json=as_json, error=error)
    elif error is not None:
        raise error


def _format(chosen: list[TableFormat], output: Path | None) -> TableFormat:
    if len(chosen) > 1:
        raise UsageError(" and ".join(f"--{each.value}" for each in chosen), "give one of them")
    by_name = TableFormat.CSV if output is None else _SUFFIXES.get(output.suffix, TableFormat.CSV)
    form = chosen[0] if chosen else by_name
    if form is TableFormat.PARQUET and output is None:
        raise UsageError("--parquet needs a file", "give one: -o FILE.parquet")
    return form


def _window(begin: str | None, end: str | None, info: RecordingInfo) -> Window:
    from robotctl.recording.read.messages import ALWAYS

    first, last = ALWAYS
    if begin is not None:
        first = parse_moment(begin, info.start_ns, info.end_ns, "--from")
    if end is not None:
        last = parse_moment(end, info.start_ns, info.end_ns, "--to")
    if first > last:
        raise UsageError(f"--to {end} is before --from {begin}")
    return first, last


def _told(
    rows: Iterable[Row], on_progress: Progress, window: Window, info: RecordingInfo
) -> Iterator[Row]:
    first_ns, last_ns = max(window[0], info.start_ns), min(window[1], info.end_ns)
    for number, row in enumerate(rows):
        if number % _PROGRESS_ROWS == 0:
            on_progress(row[0] - first_ns, max(last_ns - first_ns, 1))
        yield row


def _print(form: TableFormat, table: TopicTable, rows: Iterable[Row]) -> int:
    from robotctl.recording.table import write_csv, write_json_lines

    if form is TableFormat.JSON:
        return write_json_lines(table.columns, rows, sys.stdout)
    if sys.stdout.isatty():
        rows = (
            [printable(value) if isinstance(value, str) else value for value in row] for row in rows
        )
    return write_csv(table.columns, rows, sys.stdout)


def _write(
    form: TableFormat, table: TopicTable, rows: Iterable[Row], output: Path, source: Path
) -> int:
    from robotctl.recording.format.disk import atomic_output
    from robotctl.recording.table import write_csv, write_json_lines

    with atomic_output(output, source) as unfinished:
        if form is TableFormat.PARQUET:
            from robotctl.recording.arrays import write_parquet

            return write_parquet(table.columns, rows, unfinished)
        write = write_json_lines if form is TableFormat.JSON else write_csv
        with unfinished.open("w", encoding="utf-8", newline="") as stream:
            return write(table.columns, rows, stream)
