"""A check compares statuses, measurements, ticks and the clock with the journal.

Ticks come at multiples of their period, a little late: a removed one delays all others.
Each call of a service is one request in the journal; what is not is named.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from random import Random

import pytest

from robotctl.check.calls import MANY_IN_WORK, SERVICES, ServiceCheck
from robotctl.check.ends import Ending, JournalEnd
from robotctl.check.invariants import Invariants
from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from robotctl.check.times import ClockChanges, MissingTicks, TickSchedule
from robotctl.check.topics import RobotTopics
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ModeRequested, Tick
from robotctl.recording import read_info
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.read.messages import Message
from robotctl.testing.drives import BEGIN_NS, START_NS, Written, drive_requested, record
from tests.support.cases import for_each
from tests.support.checked_drives import drive_of_3_s
from tests.support.edited_recordings import Contents, Stored, contents_of, edit, write_contents
from tests.support.heard_drives import SET_MODE, STATUS, heard_drive, received, sent
from tests.tampering.edits import changed, check_edited, journal, metadata, renamed, with_mode


@cache
def heard() -> Contents:
    return heard_drive(3.0)


def test_the_status_of_before_the_journal_may_show_another_mode(tmp_path: Path) -> None:
    """A clip and a split begin with the last status, which may be of long before."""

    def another(number: int, message: Stored) -> Stored:
        publish_ns = message.publish_ns - 10 * NS_PER_S
        other = replace(with_mode(message, Mode.EMERGENCY_STOP), publish_ns=publish_ns)
        return message if number else other

    report = check_edited(tmp_path, edit(heard(), STATUS, another))
    assert report.verdict is Verdict.SAME, report


def test_a_status_that_is_missing_was_lost_where_losses_are_not_counted(tmp_path: Path) -> None:
    edited = edit(heard(), STATUS, lambda at, each: None if at == 1 else each)
    assert check_edited(tmp_path / "closed", edited).verdict is Verdict.BROKEN
    assert check_edited(tmp_path / "killed", edited.unclosed()).verdict is Verdict.SAME


@pytest.mark.parametrize("set_s", [-3600, -1, 1, 3600])
def test_a_wall_clock_that_is_set_is_held_against_no_status(tmp_path: Path, set_s: int) -> None:
    middle_ns = heard().messages[len(heard().messages) // 2].log_ns
    edited = heard().copy()
    for at, each in enumerate(edited.messages):
        by_ns = set_s * NS_PER_S * (each.log_ns >= middle_ns)
        later = replace(each, log_ns=each.log_ns + by_ns, publish_ns=each.publish_ns + by_ns)
        edited.messages[at] = later
    report = check_edited(tmp_path, edited)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def test_a_status_that_a_file_repeats_before_it_was_sent_is_no_difference(tmp_path: Path) -> None:
    edited = heard().copy()
    first = next(each for each in heard().messages if each.topic == STATUS)
    edited.messages.insert(0, replace(first, log_ns=first.log_ns - 1))
    report = check_edited(tmp_path, edited)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


@pytest.mark.parametrize(
    ("mode", "verdict"), [(Mode.MOVING, Verdict.SAME), (Mode.ERROR, Verdict.BROKEN)]
)
def test_a_status_topic_with_another_name_is_compared(
    tmp_path: Path, mode: Mode, verdict: Verdict
) -> None:
    """The third status shows that the robot is MOVING."""
    report = check_edited(
        tmp_path,
        heard(),
        changed(STATUS, lambda m, _: with_mode(m, mode), lambda m: m.sequence == 3),
        renamed(STATUS),
        metadata(INFO_RECORD, "topic.robot_status", f"/other{STATUS}"),
    )
    assert (report.verdict, report.missing) == (verdict, [])


def test_a_status_topic_that_is_told_and_not_recorded_is_missed(tmp_path: Path) -> None:
    report = check_edited(tmp_path, heard().without(STATUS))
    assert report.verdict is Verdict.INCOMPLETE
    assert "its topic of robot statuses, /robot_status, is not recorded" in report.missing


@cache
def measured() -> Contents:
    return heard_drive(3.0, requests=[])


def with_battery_moved(heard: Contents, by: int) -> Contents:
    """Return the contents with a battery level that many events of odometry later."""

    def change(entries: list[JournalEntry], random: Random) -> Sequence[JournalEntry | None]:
        at = [at for at, each in enumerate(entries) if each.name == "BatteryReceived"][1]
        odometry = [n for n in range(at, len(entries)) if entries[n].name == "OdomReceived"]
        to = odometry[by]
        return [*entries[:at], *entries[at + 1 : to + 1], entries[at], *entries[to + 1 :]]

    return journal(change, careful=True)(heard, Random(1))


def test_a_measurement_that_was_moved_is_found(tmp_path: Path) -> None:
    report = check_edited(tmp_path, with_battery_moved(measured(), 3))
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith("1 measurements are earlier than one before them")


PERIOD_NS = 20_000_000


def honest(seconds: float, busy_s: tuple[float, float] = (0.0, 0.0)) -> list[Tick]:
    """Return the ticks of a loop at 50 Hz that lags by up to 90 ms while it is busy."""
    random, ticks, missed = Random(1), [Tick(0)], 0
    for due_ns in range(PERIOD_NS, round(seconds * 1e9), PERIOD_NS):
        is_busy = busy_s[0] <= due_ns * 1e-9 < busy_s[1]
        t_ns = due_ns + random.randrange(15_000_000, 90_000_000) * is_busy
        t_ns += random.randrange(2_000_000)
        if t_ns < ticks[-1].t_ns:
            missed += 1
            continue
        ticks.append(Tick(t_ns, missed))
        missed = 0
    return ticks


def missing(ticks: Iterable[Tick]) -> list[MissingTicks]:
    schedule = TickSchedule()
    schedule.begin(50.0)
    for seq, tick in enumerate(ticks):
        schedule.step(tick, seq)
    schedule.stop()
    return schedule.missing


@for_each("busy_s", [(0.0, 0.0), (0.0, 2.0), (4.0, 8.0)])
def test_a_busy_loop_lacks_no_tick(busy_s: tuple[float, float]) -> None:
    assert missing(honest(12.0, busy_s)) == []


@for_each("count", [1, 10])
def test_removed_ticks_are_missing_and_counted(count: int) -> None:
    ticks = honest(6.0)
    del ticks[100 : 100 + count]
    (found,) = missing(ticks)
    assert found.ticks == count
    assert 100 <= found.seq <= 151  # in the next second


MS = 1_000_000


def set_by(folder: Path, written: list[Written], steps_s: Sequence[float]) -> Report:
    """Check a recording whose clock was set by these steps, one in 0.4 s."""

    def clock(time_ns: int) -> int:
        passed = (time_ns - START_NS - BEGIN_NS) // (400 * MS)
        return time_ns + round(sum(steps_s[:passed]) * NS_PER_S)

    return check_recording(record(folder / "run", written, clock=clock))


@pytest.mark.parametrize(("step_s", "told"), [(-3600.0, "-3600.00"), (0.7, "+0.70")])
def test_a_clock_that_was_set_once_is_a_note(tmp_path: Path, step_s: float, told: str) -> None:
    report = set_by(tmp_path, drive_of_3_s(), [step_s])
    (note,) = report.notes
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert note.startswith(f"the clock was set once, first by {told} s")


def test_a_file_that_was_sorted_by_time_after_the_clock_was_set_back_is_not_broken(
    tmp_path: Path,
) -> None:
    def clock(time_ns: int) -> int:
        return time_ns - NS_PER_S * (time_ns > START_NS + BEGIN_NS + 1_200 * MS)

    (file,) = record(tmp_path / "made", drive_of_3_s(), clock=clock).glob("*.mcap")
    contents = contents_of(file)
    contents.messages.sort(key=lambda each: each.log_ns)
    assert check_edited(tmp_path, contents).violations == []


def test_each_setting_of_the_clock_is_counted(tmp_path: Path) -> None:
    report = set_by(tmp_path, drive_of_3_s(), (0.5, 0.6, -0.7))
    (note,) = report.notes
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert note.startswith("the clock was set 3 times")


@for_each(
    ("times", "set_by"),
    [
        (((0, 0), (20, 420), (421, 421), (440, 440)), []),
        (((20, 420), (421, 421), (440, 440)), []),
        (((0, 0), (20, 281), (40, 200), (60, 100), (80, 80)), []),
        (((20, 3600_020), (40, 40)), [-3600_000]),
        (((0, 0), (20, 420), (40, 40)), [400, -400]),
        (((0, 0), (20, 420), (40, 440)), [400]),
    ],
)
def test_a_stall_sets_no_clock(times: Sequence[tuple[int, int]], set_by: list[int]) -> None:
    """Steady and wall times [ms]; a stalled entry is recorded later than its event was stamped."""
    clock = ClockChanges()
    for steady, wall in times:
        clock.look(steady * MS, wall * MS)
    assert [each.by_ns for each in clock._set] == [each * MS for each in set_by]


@pytest.mark.parametrize(
    ("before_end_s", "closed", "verdict"),
    [(0.0, True, Verdict.BROKEN), (0.0, False, Verdict.SAME), (1.0, False, Verdict.BROKEN)],
)
def test_a_call_at_the_end_may_have_its_request_after_it_unless_the_recording_was_closed(
    tmp_path: Path, before_end_s: float, closed: bool, verdict: Verdict
) -> None:
    contents = heard_drive(2.0, requests=[drive_requested(BEGIN_NS)])
    contents = contents if closed else contents.unclosed()
    at_ns = contents.messages[-1].log_ns - round(before_end_s * 1e9)
    contents.messages.append(Stored(SET_MODE, received(1, 2), at_ns, at_ns, 1))
    report = check_edited(tmp_path, contents)
    assert (report.verdict, report.missing) == (verdict, [])


WALL_NS = 1_700_000_000 * NS_PER_S
SOURCE = "the ROS service /set_mode"
BUSY = f"busy: {2 * MANY_IN_WORK} requests wait for their reply; try again"


@pytest.mark.parametrize(("in_work", "unasked"), [(0, 1), (MANY_IN_WORK + 1, 0)])
def test_a_call_is_refused_as_busy_only_while_many_are_in_work(
    tmp_path: Path, in_work: int, unasked: int
) -> None:
    topics = RobotTopics(read_info(write_contents(tmp_path / "run", heard())), "/robotctl/journal")
    report, found = Report(tmp_path), Invariants()
    check = ServiceCheck(report, topics, SERVICES[0], {}, ClockChanges())
    check.begin(0)
    numbers = count(1)

    def record_call(number: int, data: bytes) -> None:
        at_ns = WALL_NS + number * NS_PER_S
        check.message(Message(SET_MODE, "", data, at_ns, at_ns, next(numbers)))

    for number in range(in_work):
        record_call(number, received(number, 0))
        t_ns = number * NS_PER_S
        moments = t_ns, WALL_NS + t_ns, WALL_NS + t_ns
        check.request(ModeRequested(t_ns, number, 0, SOURCE), number, moments)
    record_call(in_work, received(in_work, 1))
    record_call(in_work, sent(in_work, False, BUSY, 0))
    ending = Ending(
        report, found, {}, is_clip=False, is_own=True, is_whole=True, has_begin=True, has_gaps=False
    )
    check.end(ending, JournalEnd(in_work * NS_PER_S, WALL_NS, 0, False))
    assert found.count == unasked
