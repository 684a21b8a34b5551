"""Each kind of motion is journaled: `--check` repeats it bit for bit, and `why` names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.kernel.course import Course, Held
from robotctl.kernel.patterns import Pattern, PatternKind, named
from robotctl.kernel.types import DriveRequested, Event, HoldReceived, ModeRequested, Twist
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.incident import find_incident
from robotctl.rerun.why import explain
from robotctl.testing.drives import BEGIN_NS, drive, record

MS = 1_000_000
COURSES = {
    "reverse": Course(reverse=True),
    "open loop": Course(open_loop=True),
    "waypoints": Course(waypoints=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))),
    "velocity": Course(held=Held(0.2, -0.5, 30.0)),
    "by hand": Course(held=Held(0.2, 0.1, 0.125, 0)),
}
MOTIONS = [
    *((kind.value, Pattern(kind), Course(angle_rad=3.0)) for kind in PatternKind),
    *((name, Pattern(), course) for name, course in COURSES.items()),
]


def requests(pattern: Pattern, course: Course, last: int) -> list[Event]:
    """Return a motion from 0.1 s on, held by hand until 1.2 s, and a request that ends it then."""
    begin_ns, end_ns = BEGIN_NS + 100 * MS, BEGIN_NS + 1_200 * MS
    held = course.held is not None and course.held.is_held_to_run
    return [
        DriveRequested(begin_ns, 7, pattern, 1, False, "the operator", course=course),
        *(
            HoldReceived(t_ns, 7, Twist(0.2, 0.1))
            for t_ns in range(begin_ns + 25 * MS, end_ns if held else 0, 25 * MS)
        ),
        ModeRequested(end_ns, 8, last, "somebody"),
    ]


@pytest.mark.parametrize("last", [0, 3], ids=["idle", "emergency stop"])
@pytest.mark.parametrize(("name", "pattern", "course"), MOTIONS, ids=[each[0] for each in MOTIONS])
def test_every_kind_of_motion_is_checked_and_explained(
    name: str, pattern: Pattern, course: Course, last: int, tmp_path: Path
) -> None:
    written = drive(2.0, requests=requests(pattern, course, last), snapshots_s=(0.0, 0.6))
    folder = record(tmp_path / "robot_20260101_120000", written)
    report = check_recording(folder)
    assert report.verdict is Verdict.SAME, report.as_object()
    assert any(isinstance(each, Twist) and each != Twist() for each in written)
    incident = find_incident(folder, None, lambda done, total: None).incident
    assert incident is not None
    why = explain(incident)
    assert f"{named(pattern, course)}: the operator" in why.asked
    assert "somebody" in why.came_in


def test_one_who_lets_go_is_told_so(tmp_path: Path) -> None:
    asked = requests(Pattern(), COURSES["by hand"], 0)[:20]
    asked += [HoldReceived(asked[-1].t_ns + n * 25 * MS, 7, Twist()) for n in range(1, 20)]
    folder = record(tmp_path / "robot_20260101_120000", drive(2.0, requests=asked))
    assert check_recording(folder).verdict is Verdict.SAME
    incident = find_incident(folder, None, lambda done, total: None).incident
    assert incident is not None
    why = explain(incident)
    assert why.what == "MOVING -> IDLE: let go"
    assert why.rule == "hold to run: let go, the robot ramps down"


def test_a_silence_is_explained_by_its_length(tmp_path: Path) -> None:
    asked = requests(Pattern(), COURSES["by hand"], 0)[:20]
    folder = record(tmp_path / "robot_20260101_120000", drive(2.0, requests=asked))
    assert check_recording(folder).verdict is Verdict.SAME
    incident = find_incident(folder, None, lambda done, total: None).incident
    assert incident is not None
    why = explain(incident)
    assert why.what == "MOVING -> IDLE: not held for 125 ms"
    assert why.rule == "hold to run: a silence is zero at once, and ends the motion"
