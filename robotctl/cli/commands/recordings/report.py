"""report, plot: write a recording as an HTML page, and plot the fields of a topic."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.base.errors import RecoveredWithLoss, Refused, UnreadableFile, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    cure_of_damage,
    find_recording,
)
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import (
    can_show_braille,
    duration,
    elided,
    is_terminal,
    printable,
    row,
    short_path,
    size,
)
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.names import PAGE_FILE, EventKind

if TYPE_CHECKING:
    from robotctl.show.page import CommandVerdict, Explanation, ReportFindings
    from robotctl.show.series import FieldSeries
    from robotctl.show.traces import Recorded


app = new_app()

SUFFIX: Final = ".html"

_LocalFile = Annotated[
    str,
    typer.Argument(metavar="FILE", help="An MCAP file, a recording's folder or name, or `last`."),
]


@app.command()
def report(
    file: _LocalFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="HTML", help="[default: beside the recording]"),
    ] = None,
    folder: RecordingsFolder = None,
    robot: RecordedBy = None,
    as_json: Json = False,
) -> None:
    """Write a recording as one HTML page, to read, print and pass on.

    It shows the driven path over the wanted one, commands and speeds, the error, the modes with
    their reasons, battery, ticks, the rate and the loss of each topic, what `why`, `replay --check`
    and `verify` say, and what made the recording. It needs no network. Recordings of other
    recorders are shown as far as they go. Needs neither ROS nor a daemon.

    A damaged recording is shown as far as it can be read; the exit code is then 6.

    \b
    Examples:
      robotctl report last
      robotctl report run.mcap -o run.html
    """
    if output is not None and output.suffix != SUFFIX:
        raise UsageError(f"-o {output}", f"give a name that ends in {SUFFIX}")
    from robotctl.show.page import report_page
    from robotctl.show.traces import figures_of, read_recorded

    path = find_recording(file, robot, folder)
    with progress_bar("reading", quiet=as_json) as on_progress:
        recorded = read_recorded(path, on_progress)
    judged = judge(path, recorded, quiet=as_json)
    target = output or page_of(path)
    data = report_page(recorded, judged).encode()
    with _replaced(target, "choose another file: -o FILE") as stream:
        stream.write(data)
    about = {
        "path": str(path),
        "figures": {figure.key: figure.value for figure in figures_of(recorded)},
        "verdicts": {one.command: one.verdict for one in judged.judgements},
        "is_live": recorded.is_live,
        "missing": list(recorded.missing),
    }
    answer = {"report": str(target), "bytes": len(data), "recordings": [about]}
    verdicts = ", ".join(f"{one.command}: {one.verdict}" for one in judged.judgements)
    live = ", still being written" if recorded.is_live else ""
    lines = [f"{short_path(target)} ({size(len(data))})"]
    lines += row("  ", f"{short_path(path)}{live}: {verdicts}")
    lines += [line for sentence in recorded.missing for line in row("  not read: ", sentence)]
    damaged = UnreadableFile(f"{path} could not be read completely", cure_of_damage(path))
    print_answer(answer, lines, as_json=as_json, error=damaged if recorded.missing else None)


def page_of(path: Path) -> Path:
    """Return the path of a recording's HTML page: in its folder, or next to a single MCAP file."""
    return path / PAGE_FILE if path.is_dir() else path.with_name(f"{path.stem}.{PAGE_FILE}")


@contextmanager
def _replaced(target: Path, cure: str = "") -> Iterator[IO[bytes]]:
    """Yield a stream that replaces the file `target`.

    Raises:
        Refused: The file cannot be written.
    """
    from robotctl.recording.format.disk import replaced_file

    try:
        with replaced_file(target) as stream:
            yield stream
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror or error}", cure) from error


MAX_EXPLAINED: Final = 5
"""The maximum number of explained incidents; each explanation reads the journal once."""

MAX_SENTENCES: Final = 20

_ROWS: Final = ("came_in", "known", "rule", "asked", "went_out", "since")


def judge(path: Path, recorded: Recorded, *, quiet: bool) -> ReportFindings:
    """Return the findings of `verify` and, with a journal, of `replay --check` and `why`."""
    from robotctl.check.run import check_recordings
    from robotctl.cli.commands.recordings.verify import verify_together
    from robotctl.show.page import ReportFindings

    judgements, explanations = [], []
    if recorded.has_journal:
        with progress_bar("checking", quiet=quiet) as on_progress:
            (checked,) = check_recordings([path], on_progress)
        judgements.append(_judgement("replay --check", checked, _check_sentences(checked)))
        explanations = _explained(path, recorded, quiet=quiet)
    verified = verify_together([path], quiet=quiet)["recordings"][0]
    judgements.append(_judgement("verify", verified, _verify_sentences(verified)))
    return ReportFindings(tuple(judgements), tuple(explanations))


def _judgement(command: str, report: dict[str, Any], sentences: Iterable[str]) -> CommandVerdict:
    from robotctl.show.page import CommandVerdict, Tone

    tones = {
        **dict.fromkeys(("same", "sealed"), Tone.GOOD),
        **dict.fromkeys(("incomplete", "whole"), Tone.UNSURE),
    }
    tone = tones.get(report["verdict"], Tone.BAD)
    return CommandVerdict(command, report["verdict"], tone, tuple(sentences)[:MAX_SENTENCES])


def _check_sentences(report: dict[str, Any]) -> Iterator[str]:
    if report["events"]:
        how = "bit for bit" if report["bitwise"] else "as far as they can be compared"
        yield (
            f"{duration(report['duration_s'])}: {report['events']} events, "
            f"{report['effects']} effects compared {how}, {report['commands']} commands"
        )
    found = report["divergence"]
    if found is not None:
        yield f"first difference {found['after_s']:.3f} s after the beginning, at {found['event']}"
        yield f"recorded: {found['recorded'] or 'nothing'}"
        yield f"decided: {found['decided'] or 'nothing'}"
    for each in report["violations"]:
        yield f"{each['after_s']:.3f} s after the beginning: {each['text']}"
    yield from (f"not checked: {sentence}" for sentence in report["missing"])
    yield from (f"note: {sentence}" for sentence in report["notes"])
    if report["seal"]:
        yield f"seal: {report['seal']}"


def _verify_sentences(report: dict[str, Any]) -> Iterator[str]:
    for file in report["files"]:
        seal = f", seal: {file['seal']['state']}" if file["seal"]["links"] else ""
        count = f"{file['messages']} messages"
        yield f"{file['name']}: {size(file['bytes'])}, {count}, {file['state']}{seal}"
    for name, label in (("wrong", "wrong"), ("unreadable", "not read"), ("notes", "note")):
        yield from (f"{label}: {sentence}" for sentence in report[name])


def _explained(path: Path, recorded: Recorded, *, quiet: bool) -> list[Explanation]:
    """Return explanations of the last incident and the last stops and errors, in order of time."""
    from robotctl.check.incident import find_incident
    from robotctl.cli.commands.recordings.why import FoundIncident
    from robotctl.cli.commands.recordings.why import as_object as incident_object
    from robotctl.show.page import Explanation

    stops = (EventKind.EMERGENCY_STOP, EventKind.ERROR)
    times = [event.log_ns for event in recorded.info.events if event.kind in stops]
    found: dict[int, Explanation] = {}
    for at_ns in (None, *times[::-1][: MAX_EXPLAINED - 1]):
        with progress_bar("reading the journal", quiet=quiet) as on_progress:
            try:
                incident = find_incident(path, at_ns, on_progress).incident
            except UnreadableFile:  # the verdicts name what cannot be read
                incident = None
        if incident is None or incident.seq in found:
            continue
        told = incident_object(FoundIncident(path, incident, (), ()))
        t_s = (incident.log_ns - recorded.info.start_ns) / NS_PER_S
        rows = [
            (key.replace("_", " "), "; ".join(told[key]) if key == "went_out" else told[key])
            for key in _ROWS
        ]
        shown = tuple((label, text) for label, text in rows if text)
        found[incident.seq] = Explanation(t_s, told["what"], shown)
    return [found[seq] for seq in sorted(found)]


PNG, SVG = ".png", ".svg"
WIDTH, HEIGHT = 80, 23
"""The size of the text figures without a terminal [columns, lines]."""

MAX_WIDTH: Final = 300
LEAST_ROWS: Final = 4
OTHER_LINES: Final = 2
"""The lines of a field in addition to the rows of its curve."""


@app.command()
def plot(
    file: _LocalFile,
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
        print("\n".join(_plot_lines(found, info.duration_s)))
    else:
        _write_plot(output, found, info.duration_s)
        print(short_path(output))
    missing += _left_out(found)
    if missing:
        raise RecoveredWithLoss(f"not all is drawn: {'; '.join(map(printable, missing))}")


def _plot_lines(found: Sequence[FieldSeries], duration_s: float) -> Iterator[str]:
    """Yield the figures one below the other, to fill the terminal."""
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


def _write_plot(target: Path, found: Sequence[FieldSeries], duration_s: float) -> None:
    figures = [each.figure(duration_s) for each in found]
    with _replaced(target) as stream:
        if target.suffix == PNG:
            from robotctl.show.png import write_png

            write_png(stream, figures)
        else:
            from robotctl.show.svg import figures_svg

            stream.write(figures_svg(figures).encode())


def _left_out(found: Sequence[FieldSeries]) -> Iterator[str]:
    for each in found:
        if each.series.odd:
            yield f"{each.path}: {each.series.odd} values are no finite numbers, or above 1e15"
        if each.absent:
            yield f"{each.path}: {each.absent} messages have a shorter list"
