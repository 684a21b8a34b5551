"""The wanted velocities of a guarded motion are those that were recorded."""

from __future__ import annotations

from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from robotctl.cdr.motion import encode_twist
from robotctl.config import Config
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import Event, GuardedCommandReceived, ModeRequested, Twist
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import BEGIN_NS
from robotctl.testing.hearing import WANTED
from tests.support.edited_recordings import Contents, edit, write_contents
from tests.support.heard_drives import heard_drive


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """Ten wanted velocities a second, one of them not finite."""
    wanted: list[Event] = [
        GuardedCommandReceived(
            BEGIN_NS + 250_000_000 + number * 100_000_000,
            Twist(nan if number == 20 else number / 200.0, 0.1),
        )
        for number in range(50)
    ]
    asked = ModeRequested(BEGIN_NS + 200_000_000, 1, Mode.MOVING.value, "planner")
    config = Config(kernel=replace(KernelParams(), guard=True))
    folder = tmp_path_factory.mktemp("guarded") / "run"
    return heard_drive(folder, 6.0, requests=[asked, *wanted], config=config)


def check(tmp_path: Path, contents: Contents) -> Report:
    return check_recording(write_contents(tmp_path / "run", contents))


def test_the_recorded_velocities_are_those_of_the_journal(
    tmp_path: Path, guarded: Contents
) -> None:
    report = check(tmp_path, guarded)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert guarded.counts[WANTED] == 50


def test_a_wanted_velocity_that_was_changed_is_found(tmp_path: Path, guarded: Contents) -> None:
    slower = encode_twist(Twist(0.01, 0.1))
    edited = edit(
        guarded, WANTED, lambda at, each: replace(each, data=slower) if at == 30 else each
    )
    report = check(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert "1 messages are not what the control loop received as the wanted velocity" in (
        report.violations[0].text
    )


def test_wanted_velocities_that_were_removed_are_missed(tmp_path: Path, guarded: Contents) -> None:
    edited = edit(guarded, WANTED, lambda at, each: None if at in (20, 21) else each)
    report = check(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith("2 messages of the wanted velocity")
