"""Other parameters on the same events, and in a closed loop with a simulated robot."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import UsageError
from robotctl.check.closed_loop import resimulate
from robotctl.check.what_if import check_scope, parse_settings, what_if
from robotctl.collection.index_file import DriveRow
from robotctl.collection.indexing import rows_of
from robotctl.config import Config, with_setting
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import Course, Held
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveRequested,
    Event,
    LifecycleChanged,
    LifecycleState,
    ModeRequested,
)
from robotctl.show.traces import figures_of, read_recorded
from robotctl.testing.drives import BEGIN_NS, drive, drive_requested, record
from tests.support.checked_drives import from_snapshot, make_history


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of one lap of a 1 m square."""
    written = drive(23.0, requests=[drive_requested(laps=1)], snapshots_s=(0.0, 10.0))
    return record(tmp_path_factory.mktemp("recorded") / "run", written)


def if_set(path: Path, *settings: str) -> dict[str, Any]:
    return what_if(path, parse_settings(settings))


def test_the_recorded_parameters_make_no_difference(recorded: Path) -> None:
    found = if_set(recorded, "tracking.k_y=20")
    assert found["first_difference"] is None
    assert found["angular_rps"] == {"rms": 0.0, "max": 0.0, "max_after_s": None}
    assert found["settings"] == {"tracking.k_y": {"recorded": 20.0, "what_if": "20"}}
    assert found["modes_s"]["MOVING"]["recorded"] > 15.0


def test_another_gain_changes_commands_from_some_moment_on(recorded: Path) -> None:
    found = if_set(recorded, "tracking.k_y=8", "tracking.k_x=2")
    first = found["first_difference"]
    assert first["event"].startswith("Tick ")
    assert first["recorded"] != first["what_if"]
    assert 0.0 < found["angular_rps"]["rms"] <= found["angular_rps"]["max"]
    assert first["after_s"] <= found["angular_rps"]["max_after_s"] <= found["duration_s"]
    assert found["mode_differs_s"] == 0.0


def test_a_request_that_would_have_been_refused_is_told(recorded: Path) -> None:
    found = if_set(recorded, "battery.stop_level=1", "battery.clear_level=1")
    assert found["modes_s"]["MOVING"]["what_if"] == 0.0
    assert found["mode_differs_s"] == pytest.approx(found["modes_s"]["MOVING"]["recorded"])
    (answer,) = found["answers"]
    assert answer["recorded"] == "Mode changed to MOVING"
    assert answer["what_if"].startswith("the battery is at 100%")


def test_a_key_that_changes_nothing_is_refused() -> None:
    with pytest.raises(UsageError, match="no decision depends on it; with --resim"):
        check_scope({"sim.lag_s": "0.2"}, closed_loop=False)
    with pytest.raises(UsageError, match=r"no decision depends on it$"):
        check_scope({"recording.compression": "none"}, closed_loop=True)
    with pytest.raises(UsageError, match="the ticks stay as recorded; with --resim"):
        check_scope({"rate_hz": "100"}, closed_loop=False)
    check_scope({"sim.lag_s": "0.2", "rate_hz": "100"}, closed_loop=True)


def test_a_simulation_goes_on_where_a_file_begins(tmp_path: Path) -> None:
    stop = ModeRequested(BEGIN_NS + 6_000_000_000, 2, 0, "operator")
    written = drive(8.0, requests=[drive_requested(), stop], snapshots_s=(4.0,))
    found = resimulate(record(tmp_path / "run", from_snapshot(written, 0)), {})
    (one,) = found["drives"]
    assert one["recorded"]["reason"] == one["simulated"]["reason"] == "requested by operator"
    assert one["simulated"]["distance_m"] == pytest.approx(one["recorded"]["distance_m"], rel=0.05)


def test_a_simulated_robot_is_alone_even_if_other_nodes_were_recorded(tmp_path: Path) -> None:
    at = BEGIN_NS + 500_000_000
    others: list[Event] = [
        CommandListenersSeen(BEGIN_NS + 1, 0, ()),
        CommandPublishersSeen(BEGIN_NS + 2, ("/teleop",)),
        CommandPublishersSeen(at, ()),
        CommandListenersSeen(at + 1, 1, ()),
    ]
    written = drive(4.0, requests=[*others, drive_requested(1.0)], snapshots_s=(0.25,))
    (one,) = resimulate(record(tmp_path / "run", from_snapshot(written, 0)), {})["drives"]
    assert one["simulated"]["reason"] == "under way at the end"


def test_the_recorded_configuration_is_the_one_that_is_simulated(tmp_path: Path) -> None:
    config = with_setting(with_setting(Config(), "sim.lag_s", 0.3), "rate_hz", 20.0)
    written = drive(4.0, config=config)
    found = resimulate(record(tmp_path / "run", written, config=config), {})
    (one,) = found["drives"]
    assert one["simulated"]["reason"] == "under way at the end"
    assert found["missing"] == []


def test_a_simulation_follows_the_lifecycle(tmp_path: Path) -> None:
    events: list[Event] = [
        LifecycleChanged(BEGIN_NS + 50_000_000, LifecycleState.INACTIVE, "a node"),
        LifecycleChanged(BEGIN_NS + 900_000_000, LifecycleState.ACTIVE, "a node"),
        drive_requested(1.0),
    ]
    written = drive(3.0, requests=[events[0], drive_requested(0.5)])
    (one,) = resimulate(record(tmp_path / "inactive", written), {})["drives"]
    assert one["no_drive"]["recorded"].startswith("refused: ")
    (one,) = resimulate(record(tmp_path / "active", drive(3.0, requests=events)), {})["drives"]
    assert one["simulated"]["reason"] == "under way at the end"


def test_without_a_drive_the_reason_is_said(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", drive(1.0, requests=[]))
    assert if_set(folder, "tracking.k_y=8")["no_drive"]["recorded"] == "no motion was requested"
    refused = ModeRequested(BEGIN_NS + 500_000_000, 1, 7, "operator")
    folder = record(tmp_path / "refused", drive(1.0, requests=[refused]))
    assert if_set(folder, "tracking.k_y=8")["no_drive"]["recorded"].startswith("refused: 7 is")


SLOW = {"limits.linear_mps": "0.2"}


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("history")
    make_history(folder)
    return folder


def drives(path: Path, settings: dict[str, str]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = what_if(path, settings)["drives"]
    return found


def test_with_the_same_parameters_both_sides_are_equal(history: Path) -> None:
    for recording in history.iterdir():
        for each in drives(recording, {"limits.linear_mps": "0.6"}):
            if recording.name != "lease":  # where a request changes the limit later
                assert each["recorded"] == each["what_if"]


def test_drives_that_replace_each_other_are_told_apart(history: Path) -> None:
    found = drives(history / "replaced", SLOW)
    assert [each["drive"] for each in found] == [*range(1, len(found) + 1)]
    begins = [each["after_s"] for each in found]
    assert begins == sorted(begins)
    assert len({each["request_id"] for each in found}) == len(found) > 2
    ends = [each["recorded"]["ended"] for each in found]
    assert None not in ends


def test_the_time_of_a_drive_is_that_until_its_end(history: Path) -> None:
    (one,) = drives(history / "laps", SLOW)
    for side in (one["recorded"], one["what_if"]):
        assert sum(side["modes_s"].values()) == pytest.approx(side["duration_s"], abs=0.05)
    assert one["what_if"]["duration_s"] < one["recorded"]["duration_s"], "it lost its track"
    assert one["what_if"]["cause"] == "tracking lost"


def test_a_drive_that_only_one_side_begins_is_missing_on_the_other(tmp_path: Path) -> None:
    small = Pattern(size_m=0.3)
    requests: list[Event] = [
        DriveRequested(BEGIN_NS + round(after_s * NS_PER_S), number, small, 1, False, "operator")
        for number, after_s in enumerate((0.1, 13.5), 1)
    ]
    first, second = drives(record(tmp_path / "run", drive(14.0, requests=requests)), SLOW)
    assert first["what_if"]["end_mode"] == "ERROR"
    assert second["recorded"] is not None
    assert second["what_if"] is None


def test_a_drive_that_goes_on_at_the_end_has_no_end(tmp_path: Path) -> None:
    written = drive(2.0, closed=False)
    (one,) = drives(record(tmp_path / "run", written), SLOW)
    assert one["measured"] is None
    assert [one[side]["ended"] for side in ("recorded", "what_if")] == [None, None]
    assert one["what_if"]["max_linear_mps"] == pytest.approx(0.2)


@pytest.fixture(scope="module")
def unmeasured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A velocity that is stopped, then a line whose errors are exactly 0."""
    velocity, line = Course(held=Held(0.2, 0.1, 5.0)), Pattern(PatternKind.LINE, 0.3)
    asked = (
        DriveRequested(BEGIN_NS + 100_000_000, 1, Pattern(), 1, False, "test", course=velocity),
        ModeRequested(BEGIN_NS + 1_000_000_000, 2, Mode.IDLE, "test"),
        DriveRequested(BEGIN_NS + 2_000_000_000, 3, line, 1, False, "test"),
    )
    written = drive(5.0, requests=asked)
    return record(tmp_path_factory.mktemp("unmeasured") / "robot_20260101_120000", written)


def test_a_what_if_and_a_simulation_know_no_errors_of_a_velocity(unmeasured: Path) -> None:
    velocity, line = what_if(unmeasured, {})["drives"]
    assert velocity["measured"]["distance_m"] > 0.1
    assert (velocity["measured"]["rms_error_m"], velocity["measured"]["max_error_m"]) == (None,) * 2
    assert line["measured"]["max_error_m"] is not None
    velocity, line = resimulate(unmeasured, {})["drives"]
    for side in ("recorded", "simulated"):
        assert velocity[side]["distance_m"] > 0.1
        assert velocity[side]["cross_track_rms_m"] is velocity[side]["cross_track_max_m"] is None
        assert line[side]["cross_track_rms_m"] is not None


def test_the_page_of_a_recording_leaves_a_velocity_out_of_its_errors(unmeasured: Path) -> None:
    found = read_recorded(unmeasured)
    velocity, line = found.traces.drives
    assert isnan(velocity.report.cross_track_rms_m)
    assert not isnan(line.report.cross_track_rms_m)
    figures = {each.key: each.value for each in figures_of(found)}
    assert figures["cross_track_rms_m"] == line.report.cross_track_rms_m


def test_the_index_of_a_recording_knows_no_errors_of_a_velocity(unmeasured: Path) -> None:
    rows = rows_of(unmeasured, "same", "", "whole")
    velocity, line = (row for row in rows if isinstance(row, DriveRow))
    assert velocity.pattern == "velocity"
    assert (velocity.rms_error_m, velocity.max_error_m) == (None, None)
    assert (velocity.rms_heading_rad, velocity.max_heading_rad) == (None, None)
    assert line.max_error_m is not None
