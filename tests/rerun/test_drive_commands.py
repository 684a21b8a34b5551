"""The drives of a what-if: what each kernel decides, and nothing that it cannot know."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import DriveRequested, Event
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.whatif import what_if
from robotctl.testing.drives import BEGIN_NS, drive, record
from tests.support.kernel_history import make_history

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


def test_what_only_the_robot_can_tell_stands_beside_both(history: Path) -> None:
    (one,) = drives(history / "laps", SLOW)
    assert one["measured"]["laps"] == 1
    for side in (one["recorded"], one["what_if"]):
        assert not {"laps", "distance_m", "max_error_m"} & side.keys()


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
