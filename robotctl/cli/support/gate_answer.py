"""The answer of `robotctl gate`: an object for machines, and lines for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotctl.cli.terminal.text import elided, row, short_path

if TYPE_CHECKING:
    from robotctl.collection.gate import GateReport
    from robotctl.collection.judgement import Commanded, DriveChange, Judgement

MAX_NAMED = 5
"""The number of recordings that are named for each cause, and of drives; --json names all."""

OPEN_LOOP = "the robot does not react, so how far and how well it would drive is not known"


def answer_object(place: Path, report: GateReport) -> dict[str, Any]:
    """Return what `robotctl gate --json` prints."""
    failures, unknown, totals = report.failures(), report.unknown(), report.totals()

    def state(path: Path) -> str:
        if path in report.accepted:
            return "accepted"
        return "failed" if path in failures else "unknown" if path in unknown else "passed"

    def accepted(path: Path) -> dict[str, str] | None:
        found = report.accepted.get(path)
        return None if found is None else {"by": found.by, "at": found.at, "why": found.why}

    return {
        "folder": str(place),
        "counts": report.counts(),
        "failed": len(failures),
        "unknown": len(unknown) + len(report.lost),
        "accepted": len(report.accepted),
        "stored": report.stored,
        "causes": {cause: [p.name for p in paths] for cause, paths in report.causes().items()},
        "totals": None if totals is None else asdict(totals),
        "recordings": [
            {
                "path": str(path),
                "state": state(path),
                "accepted": accepted(path),
                **result.as_object(),
            }
            for path, result in report.results.items()
        ],
        "lost": {str(path): said for path, said in report.lost.items()},
        "being_written": [str(path) for path in report.live],
    }


def answer_lines(place: Path, report: GateReport) -> Iterator[str]:
    """Yield the lines for people."""
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
        if (failure := other.failure) is not None:
            return f"{failure.after_s:.3f} s after the beginning: {failure.text}"
        if (found := other.first_difference) is not None:
            return f"{found.after_s:.3f} s after the beginning, at {found.event.split(' ')[0]}"
    return result.says


def _change_lines(report: GateReport) -> Iterator[str]:
    """Yield what other parameters change in all recordings together, and in the first drives."""
    totals = report.totals()
    if totals is None:
        return
    yield f"  {'':24}{'recorded':>12}{'what-if':>12}"
    for mode, seconds in totals.modes_s.items():
        yield f"  {f'in {mode}':24}{seconds.recorded:10.1f} s{seconds.what_if:10.1f} s"
    for label, pair, unit in (
        ("commanded", totals.commanded_m, "m"),
        ("largest speed", totals.max_linear_mps, "m/s"),
        ("largest turning speed", totals.max_angular_rps, "rad/s"),
    ):
        before, after = (f"{number:.2f} {unit}" for number in (pair.recorded, pair.what_if))
        yield f"  {label:24}{before:>12}{after:>12}"
    yield from row("  what-if: ", OPEN_LOOP)
    if totals.drives:
        yield f"  {totals.end_otherwise} of {totals.drives} drives end otherwise"
        yield f"    {'':9}{'MOVING':>9}{'commanded':>12}{'largest':>11}  ends"
        yield from _drive_lines(report)


def _drive_lines(report: GateReport) -> Iterator[str]:
    drives = [
        (path, drive)
        for path, result in report.results.items()
        if result.other is not None
        for drive in result.other.drives
    ]
    drives.sort(key=lambda each: not each[1].ends_otherwise)
    for path, drive in drives[:MAX_NAMED]:
        yield from row("  ", f"{path.name}, drive {drive.drive}: {_driven(drive)}")
        for label, side in (("recorded", drive.recorded), ("what-if", drive.what_if)):
            yield _side_line(label, side)
    if len(drives) > MAX_NAMED:
        yield f"  and {len(drives) - MAX_NAMED} more drives: --json names all"


def _driven(drive: DriveChange) -> str:
    found = drive.measured
    if found is None:
        return "its end is not recorded"
    far = "" if found.distance_m is None else f", {found.distance_m:.2f} m driven"
    return f"{found.laps} lap{'' if found.laps == 1 else 's'}{far}"


def _side_line(label: str, side: Commanded | None) -> str:
    if side is None:
        return f"    {label:9}does not begin"
    moving = f"{side.modes_s.get('MOVING', 0.0):.1f} s"
    commanded, largest = f"{side.commanded_m:.2f} m", f"{side.max_linear_mps:.2f} m/s"
    ends = "not recorded" if side.ended is None else f"{side.end_mode}: {side.cause or side.ended}"
    return f"    {label:9}{moving:>9}{commanded:>12}{largest:>11}  {elided(ends, 33)}"
