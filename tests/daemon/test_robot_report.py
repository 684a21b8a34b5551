"""The driven path, with a limited number of poses."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.daemon.control import robot_report
from robotctl.daemon.control.robot_report import MIN_STEP_M, RobotReport
from robotctl.kernel.geometry import Pose
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.testing.kernels import Bench, moving


def of(bench: Bench) -> RobotReport:
    control: Any = bench  # only its `state` is read
    return RobotReport(control)


def test_a_robot_that_stands_leaves_one_point() -> None:
    seen = of(moving())
    for _ in range(100):
        seen.drove_to(Pose(MIN_STEP_M / 2.0, 0.0, 0.0))
    assert seen.path()["driven"] == [[0.0, 0.0]]
    seen.drove_to(Pose(MIN_STEP_M, 0.0, 0.0))
    assert seen.path()["driven"] == [[0.0, 0.0], [MIN_STEP_M, 0.0]]


def test_of_a_long_way_every_second_point_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_report, "MAX_DRIVEN_POSES", 10)
    seen = of(moving())
    for number in range(1, 101):
        seen.drove_to(Pose(float(number), 0.0, 0.0))
    driven = seen.path()["driven"]
    assert len(driven) <= 10
    assert (driven[0], driven[-1]) == ([0.0, 0.0], [100.0, 0.0])


def test_another_drive_begins_another_path() -> None:
    bench = moving()
    seen = of(bench)
    seen.drove_to(Pose(1.0, 0.0, 0.0))
    bench.drive(replacing=True)
    seen.drove_to(Pose(0.1, 0.0, 0.0))
    assert seen.path()["driven"] == [[0.0, 0.0], [0.1, 0.0]]


def test_the_closure_is_told_from_the_end_of_the_first_lap_on() -> None:
    bench = moving(ticks=0)
    bench.params = bench.kernel.params  # type: ignore[attr-defined]
    bench.drive(Pattern(PatternKind.CIRCLE, 0.1), replacing=True)
    seen = of(bench)
    closures = []
    for _ in range(400):
        assert bench.state.drive is not None
        bench.odometry(bench.state.drive.reference().pose)
        bench.battery(1.0)
        bench.tick()
        facts = seen.facts()["drive"]
        assert facts is not None
        closures.append((facts["lap"], facts["closure_m"], facts["true_closure_m"]))
    assert {closure for lap, closure, _ in closures if lap == 1} == {None}
    later = [closure for lap, closure, _ in closures if lap > 1]
    assert later
    assert all(closure is not None and closure <= 0.02 for closure in later)
    assert {true for _, _, true in closures} == {None}


@pytest.mark.parametrize(("level", "is_told"), [(0.31, False), (0.29, True)])
def test_a_battery_below_30_percent_is_a_warning(level: float, is_told: bool) -> None:
    bench = moving()
    bench.battery(level)
    control: Any = bench
    bench.params = bench.kernel.params  # type: ignore[attr-defined]
    told = [text for text in RobotReport(control).warnings() if "charge it soon" in text]
    assert bool(told) is is_told
