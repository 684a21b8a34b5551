"""gate: re-run the decisions of every recording in a folder, and fail if any of them differ."""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robotctl.base.errors import Divergence, Refused, RobotctlError, UnreadableFile, UsageError
from robotctl.cli.options import Json, new_app
from robotctl.cli.targets.recordings import recording_path, recordings_folder
from robotctl.cli.ui.output import print_answer, progress_bar
from robotctl.cli.ui.text import elided, row, short_path

if TYPE_CHECKING:
    from robotctl.collection.gate import Baseline, GateReport
    from robotctl.collection.judgement import Judgement
    from robotctl.collection.judging import Engine


app = new_app()

RESULTS = ".gate"
"""The default folder of the results, within the folder of recordings."""


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
    """Decide every recording again with this robotctl, before this robotctl drives a robot.

    Each recording is checked as by `replay --check`, several at a time. A result is kept until
    the recording, robotctl or --what-if changes. --what-if also compares the modes and the
    replies under other parameters with the recorded ones. The exit code is 7 if a recording is
    broken or decided differently, or if other parameters change modes or replies; 6 if one
    cannot be judged completely; 4 if there are none. A recording that is being written is left
    out.

    \b
    Examples:
      robotctl gate --in recordings --junit gate.xml
      robotctl gate --what-if odometry.timeout_s=0.3
      robotctl gate --baseline accepted.json --accept "a shorter ramp"
      robotctl gate --in /mnt/recordings --cluster tcp://10.0.0.5:8786
    """
    from robotctl.check.what_if import check_scope, parse_settings
    from robotctl.collection.gate import Baseline, judge_all, junit_text, read_baseline
    from robotctl.collection.judging import ResultStore, judge_here

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
    from robotctl.recording.keep.listing import recordings_in

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
    """Check that the file `path` can be written; its content does not change.

    Raises:
        Refused: The file cannot be written.
    """
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
    """Return the name of this user, or the uid of a user without a name."""
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
    """Return the error of a gate that fails, or None; `problems` are errors of writing files."""
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


MAX_NAMED = 5
"""Maximum number of recordings printed for each cause, and of drives."""

OPEN_LOOP = "the robot does not react, so how far and how well it would drive is not known"


def answer_object(place: Path, report: GateReport) -> dict[str, Any]:
    """Return the object of `robotctl gate --json`; `place` is the recordings' folder."""
    failures, unknown, totals = report.failures(), report.unknown(), report.totals()

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
        "totals": totals,
        "recordings": [
            {
                "path": str(path),
                "state": state(path),
                "accepted": {key: getattr(by, key) for key in ("by", "at", "why")}
                if (by := report.accepted.get(path)) is not None
                else None,
                **result.as_object(),
            }
            for path, result in report.results.items()
        ],
        "lost": {str(path): said for path, said in report.lost.items()},
        "being_written": [str(path) for path in report.live],
    }


def answer_lines(place: Path, report: GateReport) -> Iterator[str]:
    """Yield the lines of `robotctl gate` without `--json`."""
    counted = ", ".join(f"{count} {verdict}" for verdict, count in report.counts().items() if count)
    total = len(report.results)
    yield from row("", f"{short_path(place)}: {total} recordings: {counted or 'none'}")
    yield f"  {report.stored} of them judged before, {len(report.accepted)} accepted"
    for cause, paths in report.causes().items():
        yield from _group(cause, paths)
        yield from row(" " * 9, f"first: {_first(report.results[paths[0]])}")
    for said, paths in report.lost_causes().items():
        yield from _group(f"lost: {said}", paths)
    if report.live:
        yield from _group("left out: it is being written", report.live)
    for (by, at, why), paths in report.acceptances().items():
        yield from _group(f"accepted by {by} at {at}: {why}", paths)
    yield from _change_lines(report)


def _group(title: str, paths: Sequence[Path]) -> Iterator[str]:
    more = f" and {len(paths) - MAX_NAMED} more" if len(paths) > MAX_NAMED else ""
    yield from row(f"  {len(paths):5}  ", title)
    yield from row(" " * 9, ", ".join(path.name for path in paths[:MAX_NAMED]) + more)


def _first(result: Judgement) -> str:
    other = result.other
    if other is not None and not result.says:
        if failure := other["failure"]:
            return f"{failure['after_s']:.3f} s after the beginning: {failure['text']}"
        if found := other["first_difference"]:
            at = found["event"].split(" ")[0]
            return f"{found['after_s']:.3f} s after the beginning, at {at}"
    return result.says


def _change_lines(report: GateReport) -> Iterator[str]:
    """Yield lines on the effect of --what-if: totals of all recordings, then MAX_NAMED drives."""
    totals = report.totals()
    if totals is None:
        return
    yield f"  {'':24}{'recorded':>12}{'what-if':>12}"
    for mode, seconds in totals["modes_s"].items():
        yield f"  {f'in {mode}':24}{seconds['recorded']:10.1f} s{seconds['what_if']:10.1f} s"
    for label, key, unit in (
        ("commanded", "commanded_m", "m"),
        ("largest speed", "max_linear_mps", "m/s"),
        ("largest turning speed", "max_angular_rps", "rad/s"),
    ):
        before, after = (f"{totals[key][side]:.2f} {unit}" for side in ("recorded", "what_if"))
        yield f"  {label:24}{before:>12}{after:>12}"
    yield from row("  what-if: ", OPEN_LOOP)
    if totals["drives"]:
        yield f"  {totals['end_otherwise']} of {totals['drives']} drives end otherwise"
        yield f"    {'':9}{'MOVING':>9}{'commanded':>12}{'largest':>11}  ends"
        yield from _drive_lines(report)


def _drive_lines(report: GateReport) -> Iterator[str]:
    from robotctl.collection.judgement import ends_otherwise

    drives = [
        (path, drive)
        for path, result in report.results.items()
        if result.other is not None
        for drive in result.other["drives"]
    ]
    drives.sort(key=lambda each: not ends_otherwise(each[1]))
    for path, drive in drives[:MAX_NAMED]:
        yield from row("  ", f"{path.name}, drive {drive['drive']}: {_driven(drive['measured'])}")
        for label, side in (("recorded", drive["recorded"]), ("what-if", drive["what_if"])):
            yield _side_line(label, side)
    if len(drives) > MAX_NAMED:
        yield f"  and {len(drives) - MAX_NAMED} more drives: --json names all"


def _driven(found: dict[str, Any] | None) -> str:
    if found is None:
        return "its end is not recorded"
    far = "" if found["distance_m"] is None else f", {found['distance_m']:.2f} m driven"
    return f"{found['laps']} lap{'' if found['laps'] == 1 else 's'}{far}"


def _side_line(label: str, side: dict[str, Any] | None) -> str:
    if side is None:
        return f"    {label:9}does not begin"
    moving = f"{side['modes_s'].get('MOVING', 0.0):.1f} s"
    commanded, largest = f"{side['commanded_m']:.2f} m", f"{side['max_linear_mps']:.2f} m/s"
    why = side["cause"] or side["ended"]
    ends = "not recorded" if side["ended"] is None else f"{side['end_mode']}: {why}"
    return f"    {label:9}{moving:>9}{commanded:>12}{largest:>11}  {elided(ends, 33)}"
