"""A note tells how often the clock was set."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.testing.drives import BEGIN_NS, START_NS, Written, record

MS = 1_000_000


def set_by(folder: Path, written: list[Written], steps_s: Sequence[float]) -> Report:
    """Check a recording whose clock was set by these steps, one in 0.4 s."""

    def clock(time_ns: int) -> int:
        passed = (time_ns - START_NS - BEGIN_NS) // (400 * MS)
        return time_ns + round(sum(steps_s[:passed]) * NS_PER_S)

    return check_recording(record(folder / "run", written, clock=clock))


@pytest.mark.parametrize(("step_s", "told"), [(-3600.0, "-3600.00"), (0.7, "+0.70")])
def test_a_clock_that_was_set_once_is_a_note(
    tmp_path: Path, drive_of_3_s: list[Written], step_s: float, told: str
) -> None:
    report = set_by(tmp_path, drive_of_3_s, [step_s])
    (note,) = report.notes
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert note.startswith(f"the clock was set once, first by {told} s")


def test_each_setting_of_the_clock_is_counted(tmp_path: Path, drive_of_3_s: list[Written]) -> None:
    report = set_by(tmp_path, drive_of_3_s, (0.5, 0.6, -0.7))
    (note,) = report.notes
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert note.startswith("the clock was set 3 times")


def test_a_stall_within_a_step_sets_no_clock() -> None:
    """The entry is recorded later than its event was stamped, and the next event comes after it."""
    clock = ClockChanges()
    for steady, wall in ((0, 0), (20, 420), (421, 421), (440, 440)):
        clock.look(steady * MS, wall * MS)
    assert (clock.has_changed, clock.set_by_ns) == (True, [])


def test_a_stall_within_the_first_step_sets_no_clock() -> None:
    clock = ClockChanges()
    clock.begin(0, 0)
    for steady, wall in ((20, 420), (421, 421), (440, 440)):
        clock.look(steady * MS, wall * MS)
    assert clock.set_by_ns == []


def test_a_first_step_with_a_later_time_alone_sets_the_clock_back() -> None:
    clock = ClockChanges()
    clock.begin(0, 0)
    for steady, wall in ((20, 3600_020), (40, 40)):
        clock.look(steady * MS, wall * MS)
    assert clock.set_by_ns == [-3600_000 * MS]


def test_an_entry_with_a_later_time_alone_sets_the_clock_twice() -> None:
    clock = ClockChanges()
    for steady, wall in ((0, 0), (20, 420), (40, 40)):
        clock.look(steady * MS, wall * MS)
    assert clock.set_by_ns == [400 * MS, -400 * MS]
