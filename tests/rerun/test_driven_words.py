"""How far a drive has come, in words."""

from __future__ import annotations

from dataclasses import replace

from robotctl.kernel.course import Course, Held
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.patterns import Pattern
from robotctl.rerun.sentences import driven


def test_only_a_motion_with_a_path_is_told_as_off_its_track() -> None:
    drive = Drive(1, Pattern(), 1, ORIGIN)
    velocity = replace(drive, course=Course(held=Held(0.2, 0.0, 2.0)))
    report = drive.report(0)
    assert driven(report, drive).startswith("0 laps and 0.00 m, off track 0.000 m RMS")
    assert driven(report, velocity) == "0 laps and 0.00 m"
