"""The options of `report`, and what it writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import (
    RecordedBy,
    RecordingsFolder,
    cure_of_damage,
    find_recording,
)
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import row, short_path, size
from robotctl.recording.format.names import PAGE_FILE

if TYPE_CHECKING:
    from robotctl.show.traces import KeyFigure, Recorded

app = new_app()

SUFFIX: Final = ".html"


@app.command()
def report(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="An MCAP file, a recording's folder or name, a URL, or `last`."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="HTML", help="[default: beside the recording; of a URL, here]"
        ),
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
    from robotctl.cli.commands.recordings.report.judging import judge
    from robotctl.show.page import report_page

    path = find_recording(file, robot, folder)
    recorded = _read(path, quiet=as_json)
    judged = judge(path, recorded, quiet=as_json)
    target = output or page_of(path)
    data = report_page(recorded, judged).encode()
    _write(target, data)
    about = _as_object(path, recorded, {one.command: one.verdict for one in judged.judgements})
    answer = {"report": str(target), "bytes": len(data), "recordings": [about]}
    lines = [f"{short_path(target)} ({size(len(data))})", *_lines(about)]
    damaged = UnreadableFile(f"{path} could not be read completely", cure_of_damage(path))
    print_answer(answer, lines, as_json=as_json, error=damaged if recorded.missing else None)


def _read(path: Path, *, quiet: bool) -> Recorded:
    from robotctl.show.traces import read_recorded

    with progress_bar("reading", quiet=quiet) as on_progress:
        return read_recorded(path, on_progress)


def page_of(path: Path) -> Path:
    """Return the path of a recording's page: in the folder, or next to a single recorded file."""
    return path / PAGE_FILE if path.is_dir() else path.with_name(f"{path.stem}.{PAGE_FILE}")


def _write(target: Path, data: bytes) -> None:
    from robotctl.recording.disk import replaced_file

    try:
        with replaced_file(target) as stream:
            stream.write(data)
    except OSError as error:
        raise Refused(
            f"cannot write {target}: {error.strerror or error}", "choose another file: -o FILE"
        ) from error


def _as_object(path: Path, recorded: Recorded, verdicts: dict[str, str]) -> dict[str, Any]:
    from robotctl.show.traces import figures_of

    figures: list[KeyFigure] = figures_of(recorded)
    return {
        "path": str(path),
        "figures": {figure.key: figure.value for figure in figures},
        "verdicts": verdicts,
        "is_live": recorded.is_live,
        "missing": list(recorded.missing),
    }


def _lines(about: dict[str, Any]) -> list[str]:
    verdicts = ", ".join(f"{name}: {word}" for name, word in about["verdicts"].items())
    live = ", still being written" if about["is_live"] else ""
    lines = [*row("  ", f"{short_path(about['path'])}{live}: {verdicts}")]
    for sentence in about["missing"]:
        lines += row("  not read: ", sentence)
    return lines
