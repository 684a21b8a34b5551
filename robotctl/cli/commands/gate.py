"""gate: decide every recording of a folder again, and pass only what history approves."""

from __future__ import annotations

import getpass
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.cli.options import Json, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.recording_paths import recording_path, recordings_folder
from robotctl.cli.terminal.progress import progress_bar
from robotctl.cli.terminal.text import row, short_path
from robotctl.errors import Divergence, Refused, RobotctlError, UnreadableFile, UsageError

if TYPE_CHECKING:
    from robotctl.fleet.gate import GateReport
    from robotctl.fleet.judgement import Judgement
    from robotctl.fleet.judging import Engine

app = new_app()

RESULTS = ".gate"
"""The folder of the results, in the folder of recordings."""

MAX_NAMED = 5
"""The number of recordings that are named for each cause; --json names all."""


@app.command()
def gate(
    folder: Annotated[
        Path | None,
        typer.Option(
            "--in",
            metavar="DIR|URL",
            parser=recording_path,
            help="A folder of recordings, also in a store [default: ./recordings, or the daemon's, "
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
        str | None,
        typer.Option(
            metavar="DIR|URL", help=f"Where results are kept [default: {RESULTS} in --in]."
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
    modes or answers; 6 if one cannot be judged completely.

    \b
    Examples:
      robotctl gate --in recordings --junit gate.xml
      robotctl gate --what-if odometry.timeout_s=0.3
      robotctl gate --baseline accepted.json --accept "a shorter ramp"
      robotctl gate --in s3://bucket/robots/one --cluster tcp://10.0.0.5:8786
    """
    from robotctl.fleet.baseline import Baseline, read_baseline
    from robotctl.fleet.gate import judge_all
    from robotctl.fleet.judging import judge_here
    from robotctl.fleet.junit import junit_text
    from robotctl.fleet.result_store import ResultStore
    from robotctl.recording.keep.listing import recordings_in
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
        from robotctl.fleet.cluster import Cluster

        place = place.resolve()  # a worker has another working directory
        engine = Cluster(cluster, place).judge
    try:
        recordings = recordings_in(place)
    except OSError as error:
        raise Refused(f"{place} cannot be listed: {error.strerror}") from error
    with progress_bar("judging", quiet=as_json) as on_progress:
        store = ResultStore(results or place / RESULTS)
        report = judge_all(recordings, store, settings, known, engine, on_progress)
    if accept is not None and baseline is not None:
        at = datetime.now(UTC).isoformat(timespec="seconds")
        for path, result in (report.failures() | report.unknown()).items():
            known.accept(path.name, result, by=getpass.getuser(), why=accept, at=at)
        known.write(baseline)
        report.pass_accepted(known)
    if junit is not None:
        try:
            junit.write_text(junit_text(report), encoding="utf-8")
        except OSError as error:
            raise Refused(f"cannot write {junit}: {error.strerror}") from error
    print_answer(
        _as_object(place, report), _lines(place, report), as_json=as_json, error=_error(report)
    )


def _as_object(place: Path, report: GateReport) -> dict[str, Any]:
    failures, unknown = report.failures(), report.unknown()

    def state(path: Path) -> str:
        if path in report.accepted:
            return "accepted"
        return "failed" if path in failures else "unknown" if path in unknown else "passed"

    return {
        "folder": str(place),
        "counts": report.counts(),
        "failed": len(failures),
        "unknown": len(unknown) + len(report.lost),
        "accepted": len(report.accepted),
        "stored": report.stored,
        "causes": {cause: [p.name for p in paths] for cause, paths in report.causes().items()},
        "recordings": [
            {"path": str(path), "state": state(path), **result.as_object()}
            for path, result in report.results.items()
        ],
        "lost": {str(path): said for path, said in report.lost.items()},
    }


def _lines(place: Path, report: GateReport) -> Iterator[str]:
    counted = ", ".join(f"{count} {verdict}" for verdict, count in report.counts().items() if count)
    total = len(report.results)
    yield f"{short_path(place)}: {total} recordings: {counted or 'none'}"
    yield f"  {report.stored} of them judged before, {len(report.accepted)} accepted"
    for cause, paths in report.causes().items():
        yield from row(f"  {len(paths):5}  ", cause)
        yield from row(" " * 9, _names(paths))
        yield from row(" " * 9, f"first: {_first(report.results[paths[0]])}")
    for said, paths in report.lost_causes().items():
        yield from row(f"  {len(paths):5}  ", f"lost: {said}")
        yield from row(" " * 9, _names(paths))
    yield from _change_lines(report)


def _names(paths: Sequence[Path]) -> str:
    more = f" and {len(paths) - MAX_NAMED} more" if len(paths) > MAX_NAMED else ""
    return ", ".join(path.name for path in paths[:MAX_NAMED]) + more


def _first(result: Judgement) -> str:
    other = result.other
    if other is not None and result.differs and other["first_difference"]:
        found = other["first_difference"]
        return f"{found['after_s']:.3f} s after the beginning, at {found['event'].split(' ')[0]}"
    return result.says


def _change_lines(report: GateReport) -> Iterator[str]:
    """Yield what other parameters change in all recordings together."""
    others = [each.other for each in report.results.values() if each.other is not None]
    if not others:
        return
    yield f"  {'time in mode':16}{'recorded':>12}{'what-if':>12}"
    for mode in others[0]["modes_s"]:
        before = sum(each["modes_s"][mode]["recorded"] for each in others)
        after = sum(each["modes_s"][mode]["what_if"] for each in others)
        yield f"  {mode:16}{before:10.1f} s{after:10.1f} s"
    largest = max(each["linear_mps"]["max"] for each in others)
    yield f"  commands differ by up to {largest:.3f} m/s"


def _error(report: GateReport) -> RobotctlError | None:
    if failures := report.failures():
        return Divergence(f"{len(failures)} of {len(report.results)} recordings do not pass")
    if unknown := len(report.unknown()) + len(report.lost):
        return UnreadableFile(f"{unknown} recordings could not be judged completely")
    return None
