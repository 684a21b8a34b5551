"""The journal explains why the robot was stopped or a request was refused.

Each kind of motion is journaled: `--check` repeats it bit for bit, and `why` names it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from robotctl.check.incident import Incident, IncidentKind, find_incident
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.check.why import explain, rule_of
from robotctl.kernel.course import Course, Held
from robotctl.kernel.patterns import Pattern, PatternKind, named
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    CommandPublishersSeen,
    DriveRequested,
    Event,
    FaultReported,
    HoldReceived,
    LeaseLost,
    LeaseRequested,
    ModeRequested,
    Remedy,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.recording.write.bag_writer import RecordingFile
from robotctl.testing.drives import BEGIN_NS, START_NS, Written, drive, drive_requested, record
from tests.support.checked_drives import from_snapshot


def at(seconds: float) -> int:
    return BEGIN_NS + round(seconds * 1e9)


def incident(folder: Path, at_ns: int | None = None) -> Incident:
    found = find_incident(folder, at_ns).incident
    assert found is not None
    return found


def same_incident(folder: Path, written: list[Written]) -> Incident:
    """Return the incident of a recording whose decisions are the same again."""
    made = record(folder / "robot_20260101_120000", written)
    report = check_recording(made)
    assert report.verdict is Verdict.SAME, report.as_object()
    return incident(made)


ESTOP = ModeRequested(at(2.0), 2, 3, "robotctl estop (pid 99)")


@dataclass(frozen=True)
class Case:
    """Events that end a drive, and the expected explanation."""

    said: tuple[str, ...]
    requests: tuple[Event, ...] = ()
    then: tuple[Event, ...] = ()
    kind: IncidentKind = IncidentKind.FAULT


CASES = {
    "operator": Case(
        (
            "MOVING -> EMERGENCY_STOP: requested by robotctl estop (pid 99)",
            "a request for EMERGENCY_STOP by robotctl estop (pid 99)",
            "a request for EMERGENCY_STOP is always granted",
            "a square: operator, 1.9 s before",
            "the emergency stop is latched, also over a restart",
        ),
        requests=(ESTOP,),
        kind=IncidentKind.STOP,
    ),
    "battery": Case(
        (
            "a battery level of 14.0%",
            "battery low: in MOVING it leads to EMERGENCY_STOP (battery.stop_level is 0.15",
        ),
        requests=(BatteryReceived(at(2.1), 0.14),),
    ),
    "odometry": Case(
        (
            "a control tick",
            "odometry 520 ms old",
            "odometry lost: in MOVING it leads to ERROR (odometry.timeout_s is 0.5)",
        ),
        then=tuple(Tick(at(2.2) + tick * 20_000_000) for tick in range(1, 60)),
    ),
    "gap": Case(("tick overrun: in MOVING", "max_tick_gap_s is 0.3"), then=(Tick(at(3.1)),)),
    "another operator": Case(
        ("/teleop publishes velocity commands, too", "foreign publisher: in MOVING it leads to"),
        requests=(CommandPublishersSeen(at(2.0), ("/teleop",)),),
    ),
    "daemon": Case(
        ("a report of the daemon, task died: KeyError", "task died: in IDLE and MOVING"),
        requests=(FaultReported(at(2.0), Cause.TASK_DIED, "KeyError"),),
    ),
    "idle": Case(
        (
            "a request for IDLE by operator, 501 ms before the robot stood",
            "request idle in MOVING: IDLE, after ramping down",
            "ramped down in 501 ms, then zero velocity",
        ),
        requests=(ModeRequested(at(2.0), 2, 0, "operator"),),
        kind=IncidentKind.STOP,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_chain_of_a_stop_is_told(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    written = drive(
        2.2 if case.then else 3.0, requests=[drive_requested(), *case.requests], then=case.then
    )
    found = same_incident(tmp_path, written)
    assert found.kind is case.kind
    why = explain(found)
    rule = rule_of(found)
    remedies = (rule.remedy,) if rule is not None and case.kind is IncidentKind.FAULT else ()
    assert why.remedies == remedies
    told = str(why)
    for sentence in case.said:
        assert sentence in told
    assert found.zero_ns is not None
    assert 0 <= found.zero_ns - found.log_ns < 1_000_000


RAMP = drive(
    3.0,
    requests=[drive_requested(), ModeRequested(at(2.0), 2, 0, "operator")],
    snapshots_s=(0.0, 2.2),
)


def test_a_ramp_that_began_in_an_earlier_file_is_told_as_such(tmp_path: Path) -> None:
    told = explain(incident(record(tmp_path / "run", from_snapshot(RAMP, 1))))
    assert told.came_in == "requested by operator: the ramp began before this recording"


def test_a_refusal_names_the_condition_and_its_rule(tmp_path: Path) -> None:
    refused = ModeRequested(at(-0.1), 1, 1, "operator")
    found = incident(record(tmp_path / "run", drive(0.5, requests=[refused])))
    assert found.kind is IncidentKind.REFUSAL
    told = explain(found)
    assert told.what.startswith("refused: no odometry was received on odom yet")
    assert told.remedies == (Remedy.CHECK_ODOMETRY_IS_PUBLISHED,)
    assert told.rule == "odometry lost prevents a start (odometry.timeout_s is 0.5)"
    assert told.went_out == ()


LEASED = LeaseRequested(at(-0.1), 1, True, 7, "the inspector", "inspection")


@pytest.mark.parametrize(
    "asked",
    [
        replace(drive_requested(1.0), request_id=2, client=8),
        ModeRequested(at(1.0), 2, 1, "one without an identity"),
        LeaseRequested(at(1.0), 2, True, 8, "another"),
        LeaseRequested(at(1.0), 2, False, 8, "another"),
    ],
    ids=["drive", "mode", "take", "release"],
)
def test_a_refusal_for_the_lease_names_its_holder_and_the_rule(
    tmp_path: Path, asked: DriveRequested | ModeRequested | LeaseRequested
) -> None:
    found = same_incident(tmp_path, drive(2.0, requests=[LEASED, asked]))
    assert found.kind is IncidentKind.REFUSAL
    told = explain(found)
    said = f"the inspector holds the lease (inspection), and {asked.source} asked"
    assert told.what == f"refused: {said}"
    assert told.rule == "the lease: its holder alone starts and steers motion"
    assert told.remedies == (Remedy.WAIT_FOR_LEASE,)


def test_a_stop_for_a_lost_lease_tells_how_it_was_lost(tmp_path: Path) -> None:
    driving = replace(drive_requested(0.5), request_id=2, client=7)
    lost = LeaseLost(at(2.0), 7, "nothing was heard from it for 1 s")
    folder = record(tmp_path / "run", drive(3.0, requests=[LEASED, driving, lost]))
    told = explain(incident(folder))
    assert "the inspector lost the lease: nothing was heard from it for 1 s" in told.what
    assert told.came_in.startswith("the loss of the lease by its holder: nothing was heard")
    assert told.rule == "the lease: motion ends with it"


def test_what_is_nearest_to_a_time_is_told_with_what_came_of_it(tmp_path: Path) -> None:
    asked: list[Event] = [
        drive_requested(),
        ESTOP,
        ResetRequested(at(2.5), 3, "robotctl reset"),
        ModeRequested(at(5.0), 4, 7, "operator"),
    ]
    folder = record(tmp_path / "run", drive(6.0, requests=asked))
    assert incident(folder).kind is IncidentKind.REFUSAL
    found = incident(folder, START_NS + at(2.3))
    assert found.kind is IncidentKind.STOP
    assert explain(found).since == ("500 ms later EMERGENCY_STOP -> IDLE: reset by robotctl reset")


def test_a_stop_after_a_later_snapshot_is_explained_from_there(tmp_path: Path) -> None:
    written = drive(3.0, requests=[drive_requested(), ESTOP], snapshots_s=(0.0, 1.0))
    found = incident(record(tmp_path / "run", from_snapshot(written, 1)))
    assert found.before is not None
    assert found.before.drive is not None
    assert explain(found).asked == "a square: operator"


def test_without_a_snapshot_before_it_says_what_it_cannot_tell(tmp_path: Path) -> None:
    written = drive(3.0, requests=[drive_requested(), ESTOP])
    told = explain(incident(record(tmp_path / "run", written[200:])))
    assert told.what == "MOVING -> EMERGENCY_STOP: requested by robotctl estop (pid 99)"
    assert told.known.startswith("unknown: ")


def test_where_nothing_happened_it_says_so(tmp_path: Path) -> None:
    found = find_incident(record(tmp_path / "run", drive(1.0)))
    assert (found.incident, found.missing) == (None, [])


@pytest.fixture
def unclosed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave recordings unclosed, as a killed process does."""
    monkeypatch.setattr(RecordingFile, "finish", RecordingFile.abandon)


@pytest.mark.usefixtures("unclosed")
def test_a_recording_that_ends_by_a_kill_in_moving_says_so(tmp_path: Path) -> None:
    refused = ModeRequested(at(1.0), 2, 7, "operator")
    killed = drive(2.0, requests=[drive_requested(), refused], closed=False)
    found = incident(record(tmp_path / "run", killed))
    assert found.kind is IncidentKind.KILL
    told = explain(found)
    assert told.what.endswith("the daemon was killed, or could write no more")
    assert told.asked == "a square: operator, 1.9 s before"
    assert "from where it should be" in told.known
    (sent,) = told.went_out
    assert sent.startswith("no recorded zero velocity")
    assert (told.rule, told.since) == ("", "")


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
    why = explain(same_incident(tmp_path, written))
    assert any(isinstance(each, Twist) and each != Twist() for each in written)
    assert f"{named(pattern, course)}: the operator" in why.asked
    assert "somebody" in why.came_in


def test_one_who_lets_go_is_told_so(tmp_path: Path) -> None:
    asked = requests(Pattern(), COURSES["by hand"], 0)[:20]
    asked += [HoldReceived(asked[-1].t_ns + n * 25 * MS, 7, Twist()) for n in range(1, 20)]
    why = explain(same_incident(tmp_path, drive(2.0, requests=asked)))
    assert why.what == "MOVING -> IDLE: let go"
    assert why.rule == "hold to run: let go, the robot ramps down"
