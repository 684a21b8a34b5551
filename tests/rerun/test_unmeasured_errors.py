"""A velocity has no path: what is told of its drive knows no errors, and does not call them 0."""

from __future__ import annotations

from math import isnan
from pathlib import Path

import pytest

from robotctl.fleet.history import rows_of
from robotctl.fleet.rows import DriveRow
from robotctl.kernel.course import Course, Held
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.rerun.resim import resimulate
from robotctl.rerun.whatif import what_if
from robotctl.show.traces import figures_of, read_recorded
from robotctl.testing.drives import BEGIN_NS, drive, record


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A velocity that is stopped, then a line whose errors are exactly 0."""
    velocity, line = Course(held=Held(0.2, 0.1, 5.0)), Pattern(PatternKind.LINE, 0.3)
    asked = (
        DriveRequested(BEGIN_NS + 100_000_000, 1, Pattern(), 1, False, "test", course=velocity),
        ModeRequested(BEGIN_NS + 1_000_000_000, 2, Mode.IDLE, "test"),
        DriveRequested(BEGIN_NS + 2_000_000_000, 3, line, 1, False, "test"),
    )
    written = drive(5.0, requests=asked)
    return record(tmp_path_factory.mktemp("unmeasured") / "robot_20260101_120000", written)


def test_a_what_if_and_a_simulation_know_no_errors_of_a_velocity(folder: Path) -> None:
    velocity, line = what_if(folder, {})["drives"]
    assert velocity["measured"]["distance_m"] > 0.1
    assert (velocity["measured"]["rms_error_m"], velocity["measured"]["max_error_m"]) == (None,) * 2
    assert line["measured"]["max_error_m"] is not None
    velocity, line = resimulate(folder, {})["drives"]
    for side in ("recorded", "simulated"):
        assert velocity[side]["distance_m"] > 0.1
        assert velocity[side]["cross_track_rms_m"] is velocity[side]["cross_track_max_m"] is None
        assert line[side]["cross_track_rms_m"] is not None


def test_the_page_of_a_recording_leaves_a_velocity_out_of_its_errors(folder: Path) -> None:
    found = read_recorded(folder)
    velocity, line = found.traces.drives
    assert isnan(velocity.report.cross_track_rms_m)
    assert not isnan(line.report.cross_track_rms_m)
    figures = {each.key: each.value for each in figures_of(found)}
    assert figures["cross_track_rms_m"] == line.report.cross_track_rms_m


def test_the_index_of_a_recording_knows_no_errors_of_a_velocity(folder: Path) -> None:
    rows = rows_of(folder, "same", "", "whole")
    velocity, line = (row for row in rows if isinstance(row, DriveRow))
    assert velocity.pattern == "velocity"
    assert (velocity.rms_error_m, velocity.max_error_m) == (None, None)
    assert (velocity.rms_heading_rad, velocity.max_heading_rad) == (None, None)
    assert line.max_error_m is not None
