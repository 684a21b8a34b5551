"""gate: decide every recording of a folder again, and pass only what history approves."""

from __future__ import annotations

import getpass
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robotctl.cli.options import Json, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.gate_answer import answer_lines, answer_object
from robotctl.cli.support.recording_paths import recording_path, recordings_folder
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import short_path
from robotctl.errors import Divergence, Refused, RobotctlError, UnreadableFile, UsageError

if TYPE_CHECKING:
    from robotctl.collection.gate import Baseline, GateReport
    from robotctl.collection.judging import Engine

app = new_app()

RESULTS = ".gate"
"""The folder of the results, in the folder of recordings."""


@app.command()
def gate(
    folder: Annotated[
        Path | None,
        typer.Option(
            "--in",
            metavar="DIR",
            parser=recording_path,
            help="A folder of recordings [default: ./recordings, or the daemon's, "
            "or the last daemon's].",
        ),
    ] = None,
    what_if: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Judge this parameter, too; repeatable."),
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Pass what this file accepts.")
    ] = None,
    accept: Annotated[
        str | None,
        typer.Option(metavar="WHY", help="Accept what is wrong now, and add it to the baseline."),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            parser=recording_path,
            help=f"Where results are kept [default: {RESULTS} in --in].",
        ),
    ] = None,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write JUnit XML here, too.")
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Judge on the workers of this Dask scheduler: tcp://HOST:PORT."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Decide every recording again with this robotctl, before it drives.

    Each recording is checked as by `replay --check`, in a process per processor. Results are
    kept: a second run judges only recordings that are new, or all after robotctl has changed.
    With --what-if, modes and answers with other parameters are compared with the recorded ones.
    The exit code is 7 if a recording is decided differently or broken, or other parameters change
    modes or answers; 6 if one cannot be judged completely; 4 if there are none. A recording that is
    being written is left out.

    \b
    Examples:
      robotctl gate --in recordings --junit gate.xml
      robotctl gate --what-if odometry.timeout_s=0.3
      robotctl gate --baseline accepted.json --accept "a shorter ramp"
      robotctl gate --in /mnt/recordings --cluster tcp://10.0.0.5:8786
    """
    from robotctl.collection.gate import Baseline, judge_all, junit_text, read_baseline
    from robotctl.collection.judging import ResultStore, judge_here
    from robotctl.rerun.recorded_settings import check_scope, parse_settings

    if accept is not None and baseline is None:
        raise UsageError("--accept WHY needs a file to write to", "give --baseline FILE")
    if folder is not None and not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    settings = parse_settings(what_if or ())
    check_scope(settings, closed_loop=False)
    known = Baseline() if baseline is None else read_baseline(baseline)
    place = folder or recordings_folder(None, None)
    engine: Engine = judge_here
    if cluster is not None:
        from robotctl.collection.cluster import Cluster

        place = place.resolve()  # a worker has another working directory
        engine = Cluster(cluster, place).judge
    recordings = _recordings(place)
    for file in filter(None, (junit, baseline if accept is not None else None)):
        _check_writable(file)
    by = _user()
    with progress_bar("judging", quiet=as_json) as on_progress:
        store = ResultStore(results or place / RESULTS)
        report = judge_all(recordings, store, settings, known, engine, on_progress)
    problems: list[RobotctlError] = []
    if accept is not None and baseline is not None:
        try:
            _accept(report, known, baseline, by, accept)
        except Refused as error:
            problems.append(error)
    if junit is not None:
        try:
            junit.write_text(junit_text(report), encoding="utf-8")
        except OSError as error:
            problems.append(_cannot_write(junit, error))
    print_answer(
        answer_object(place, report),
        answer_lines(place, report),
        as_json=as_json,
        error=_error(report, problems),
    )


def _recordings(place: Path) -> list[Path]:
    from robotctl.recording.keep.catalog import recordings_in

    try:
        found = recordings_in(place)
    except OSError as error:
        raise Refused(f"{place} cannot be listed: {error.strerror}") from error
    if not found:
        raise Refused(
            f"{short_path(place)} holds no recordings, so nothing was judged",
            "give --in the folder above them",
        )
    return found


def _check_writable(path: Path) -> None:
    """Refuse a file that cannot be written, before anything is judged."""
    existed = path.exists()
    try:
        with path.open("a"):
            pass
        if not existed:
            path.unlink()
    except OSError as error:
        raise _cannot_write(path, error) from error


def _cannot_write(path: Path, error: OSError) -> Refused:
    return Refused(f"cannot write {path}: {error.strerror or error}")


def _user() -> str:
    """Return who accepts: in a container a user may have no name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def _accept(report: GateReport, known: Baseline, baseline: Path, by: str, why: str) -> None:
    at = datetime.now(UTC).isoformat(timespec="seconds")
    for path, result in (report.failures() | report.unknown()).items():
        known.accept(path.name, result, by=by, why=why, at=at)
    known.write(baseline)
    report.pass_accepted(known)


def _error(report: GateReport, problems: Sequence[RobotctlError]) -> RobotctlError | None:
    """Return why the gate does not pass; what could not be written comes last."""
    also = "".join(f"; {problem}" for problem in problems)
    if failures := report.failures():
        return Divergence(f"{len(failures)} of {len(report.results)} recordings do not pass{also}")
    if unknown := len(report.unknown()) + len(report.lost):
        return UnreadableFile(f"{unknown} recordings could not be judged completely{also}")
    if not report.results:
        return Refused(
            f"nothing was judged: all recordings are being written{also}",
            "stop the robot, or wait for its next recording",
        )
    return problems[0] if problems else None
