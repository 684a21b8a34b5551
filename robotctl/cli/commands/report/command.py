"""The options of `report`, and what it writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from robotctl.cli.options import Json, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.recording_paths import (
    RecordedBy,
    RecordingsFolder,
    cure_of_damage,
    find_recording,
)
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import row, short_path, size
from robotctl.errors import Refused, UnreadableFile, UsageError
from robotctl.recording.format.derived_files import PAGE_FILE, comparison_file

if TYPE_CHECKING:
    from robotctl.report.figures import Figure
    from robotctl.report.recorded import Recorded

app = new_app()

SUFFIX: Final = ".html"
COMPARED: Final = 2


@app.command()
def report(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE", help="An MCAP file, a recording's folder or name, a URL, or `last`."
        ),
    ],
    compare: Annotated[
        bool, typer.Option("--compare", help="Two recordings beside each other, on one page.")
    ] = False,
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
      robotctl report --compare recordings/robot_20260101_120000 last
    """
    if len(files) != (COMPARED if compare else 1):
        cure = "give two recordings" if compare else "give one, or two with --compare"
        raise UsageError(f"{len(files)} recordings", cure)
    if output is not None and output.suffix != SUFFIX:
        raise UsageError(f"-o {output}", f"give a name that ends in {SUFFIX}")
    from robotctl.cli.commands.report.judging import judge
    from robotctl.report.compare import comparison_page
    from robotctl.report.page import report_page

    paths = [find_recording(file, robot, folder) for file in files]
    recorded = [_read(path, quiet=as_json) for path in paths]
    judged = [judge(path, each, quiet=as_json) for path, each in zip(paths, recorded, strict=True)]
    if compare:
        page = comparison_page((recorded[0], judged[0]), (recorded[1], judged[1]))
        target = output or _beside(paths[0], comparison_file(paths[1].resolve().stem))
    else:
        page = report_page(recorded[0], judged[0])
        target = output or page_of(paths[0])
    data = page.encode()
    _write(target, data)
    reports = [
        _as_object(path, each, {one.command: one.verdict for one in found.judgements})
        for path, each, found in zip(paths, recorded, judged, strict=True)
    ]
    answer = {"report": str(target), "bytes": len(data), "recordings": reports}
    lines = [f"{short_path(target)} ({size(len(data))})", *_lines(reports)]
    print_answer(answer, lines, as_json=as_json, error=_incomplete(paths, recorded))


def _read(path: Path, *, quiet: bool) -> Recorded:
    from robotctl.report.recorded import read_recorded

    with progress_bar("reading", quiet=quiet) as on_progress:
        return read_recorded(path, on_progress)


def page_of(path: Path) -> Path:
    """Return where the page of a recording is written."""
    return _beside(path, PAGE_FILE)


def _beside(path: Path, name: str) -> Path:
    """Return where a page about a recording goes: into its folder, or beside the file.

    That of a recording in a store goes into the working directory.
    """
    from robotctl.store.store_path import StorePath

    if isinstance(path, StorePath):
        return Path(f"{path.stem}.{name}")
    return path / name if path.is_dir() else path.with_name(f"{path.stem}.{name}")


def _write(target: Path, data: bytes) -> None:
    from robotctl.recording.disk.replaced_file import replaced_file

    try:
        with replaced_file(target) as stream:
            stream.write(data)
    except OSError as error:
        raise Refused(
            f"cannot write {target}: {error.strerror or error}", "choose another file: -o FILE"
        ) from error


def _as_object(path: Path, recorded: Recorded, verdicts: dict[str, str]) -> dict[str, Any]:
    from robotctl.report.figures import figures_of

    figures: list[Figure] = figures_of(recorded)
    return {
        "path": str(path),
        "figures": {figure.key: figure.value for figure in figures},
        "verdicts": verdicts,
        "is_live": recorded.is_live,
        "missing": list(recorded.missing),
    }


def _lines(reports: list[dict[str, Any]]) -> list[str]:
    lines: list[str] = []
    for each in reports:
        verdicts = ", ".join(f"{name}: {word}" for name, word in each["verdicts"].items())
        live = ", still being written" if each["is_live"] else ""
        lines += row("  ", f"{short_path(each['path'])}{live}: {verdicts}")
        for sentence in each["missing"]:
            lines += row("  not read: ", sentence)
    return lines


def _incomplete(paths: list[Path], recorded: list[Recorded]) -> UnreadableFile | None:
    for path, each in zip(paths, recorded, strict=True):
        if each.missing:
            return UnreadableFile(
                f"{path} could not be read completely",
                cure_of_damage(path),
            )
    return None
