"""A configuration excuses the lack of the topics that its patterns leave out, and of no others."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.recorded_filter import MAX_TEXT
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import heard_drive
from tests.tampering.edits import metadata, removed


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return heard_drive(tmp_path_factory.mktemp("heard") / "run", 3.6)


@pytest.mark.parametrize(
    ("key", "patterns", "topic", "verdict"),
    [
        ("exclude", "['/battery_state']", BATTERY, Verdict.SAME),
        ("exclude", "['/camera/*', '/battery*']", BATTERY, Verdict.SAME),
        ("exclude", "['type:sensor_msgs/msg/BatteryState']", BATTERY, Verdict.SAME),
        ("exclude", "['/camera/*']", BATTERY, Verdict.BROKEN),
        ("exclude", "['type:sensor_msgs/msg/Image']", BATTERY, Verdict.BROKEN),
        ("include", "['/cmd_vel', '/odom']", BATTERY, Verdict.SAME),
        ("include", "['/battery_state']", BATTERY, Verdict.BROKEN),
        ("exclude", "['/odom']", ODOMETRY, Verdict.BROKEN),
        ("include", "['/cmd_vel']", ODOMETRY, Verdict.BROKEN),
        ("exclude", "/battery_state", BATTERY, Verdict.BROKEN),
        ("exclude", "[1]", BATTERY, Verdict.BROKEN),
        ("exclude", "[" * MAX_TEXT, BATTERY, Verdict.BROKEN),
    ],
)
def test_only_what_the_patterns_leave_out_may_lack(
    tmp_path: Path, honest: Contents, key: str, patterns: str, topic: str, verdict: Verdict
) -> None:
    named = metadata("robotctl", f"parameter.recording.{key}", patterns)(honest, Random(1))
    report = check_recording(write_contents(tmp_path / "run", removed(topic)(named, Random(1))))
    assert report.verdict is verdict
    assert any("as configured" in note for note in report.notes) is (verdict is Verdict.SAME)
