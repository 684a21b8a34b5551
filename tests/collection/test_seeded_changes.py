"""The gate catches regressions of the kernel, and lets harmless changes of its sources pass."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import robotctl
from robotctl import __version__
from robotctl.collection.content import software_hash
from tests.support.checked_drives import make_history


@dataclass(frozen=True, slots=True)
class SourceChange:
    """In a file of the kernel, `old` becomes `new`; `old` stands there once."""

    name: str
    file: str
    old: str
    new: str

    def apply(self, kernel: Path) -> None:
        """Change the file below the folder `kernel`."""
        path = kernel / self.file
        text = path.read_text()
        assert text.count(self.old) == 1, f"{self.name}: {self.file} does not hold it once"
        path.write_text(text.replace(self.old, self.new))


REGRESSIONS = (
    SourceChange(
        "ramps are 1 % steeper",
        "tracking.py",
        "limits.linear_accel_mps2 * dt_s",
        "1.01 * limits.linear_accel_mps2 * dt_s",
    ),
    SourceChange(
        "a large error in heading counts less",
        "tracking.py",
        "gains.k_theta * error.theta",
        "gains.k_theta * sin(error.theta)",
    ),
    SourceChange(
        "curvature is fed forward at the speed of the reference",
        "tracking.py",
        "+ reference.curvature * linear",
        "+ reference.curvature * reference.linear",
    ),
    SourceChange(
        "an error in heading does not slow down",
        "tracking.py",
        "reference.linear * cos(error.theta)",
        "reference.linear",
    ),
    SourceChange(
        "the plan leaves less to catch up", "speed_plan.py", "SPEED_SHARE = 0.95", "SPEED_SHARE = 1"
    ),
    SourceChange(
        "braking begins a little later",
        "drive.py",
        "brakes_from, half = end_speed * end_speed + 2.0 * leg.accel * left",
        "brakes_from, half = end_speed * end_speed + 2.02 * leg.accel * left",
    ),
    SourceChange(
        "one lap more",
        "drive.py",
        "return 0 < self.laps <= self.progress.laps",
        "return 0 < self.laps < self.progress.laps",
    ),
    SourceChange(
        "the score takes another error",
        "drive.py",
        "so_far.squared_error_sum + cross_m * cross_m",
        "so_far.squared_error_sum + error_m * error_m",
    ),
    SourceChange(
        "a replacing drive begins at rest",
        "kernel.py",
        "speed_mps = -command.linear if course.reverse else command.linear",
        "speed_mps = 0.0",
    ),
    SourceChange(
        "a lost odometry is noticed 20 ms later",
        "checks.py",
        "if age_s <= params.odometry.timeout_s:",
        "if age_s <= params.odometry.timeout_s + 0.02:",
    ),
    SourceChange(
        "a hanging odometry counts as new",
        "odometry.py",
        "is_news = not fault and not is_repeated(health, odometry)",
        "is_news = not fault",
    ),
    SourceChange(
        "a jump of odometry is believed",
        "odometry.py",
        "if jump_m > params.max_jump_m:",
        "if jump_m > 10.0 * params.max_jump_m:",
    ),
    SourceChange(
        "the stop level of the battery is just above",
        "checks.py",
        "not is_level(level) or level > stop_level:",
        "not is_level(level) or level >= stop_level:",
    ),
    SourceChange(
        "a drained battery releases the stop",
        "checks.py",
        "(is_level(level) and level >= clear_level)",
        "is_level(level)",
    ),
    SourceChange(
        "IDLE does not wait for the ramp",
        "modes.py",
        "(go(idle), go(idle, ramp),",
        "(go(idle), go(idle),",
    ),
    SourceChange(
        "an operator's stop is not latched",
        "kernel.py",
        "self._effects.append(LatchEmergencyStop(reason, cause))",
        "if cause is not Cause.OPERATOR_STOP:\n"
        "                self._effects.append(LatchEmergencyStop(reason, cause))",
    ),
    SourceChange(
        "the lease keeps nobody away",
        "kernel.py",
        "if lease is None or lease.client == event.client:",
        "if lease is None or lease.client != 0:",
    ),
    SourceChange(
        "a limit changes in motion",
        "kernel.py",
        "if change is Change.STANDING and self.state.mode is Mode.MOVING:",
        "if change is Change.STANDING and leaf is None and self.state.mode is Mode.MOVING:",
    ),
    SourceChange(
        "the fence is half a metre wider",
        "fence.py",
        "not distance_m <= params.radius_m:",
        "not distance_m <= params.radius_m + 0.5:",
    ),
    SourceChange(
        "the reference goes on through a stall",
        "kernel.py",
        "drive = None if state.drive is None else state.drive.from_standstill()",
        "drive = state.drive",
    ),
)

HARMLESS = (
    SourceChange(
        "the sign is compared",
        "tracking.py",
        "return copysign(bound, value) if isfinite(value) else 0.0",
        "return (bound if value > 0.0 else -bound) if isfinite(value) else 0.0",
    ),
    SourceChange(
        "the condition is turned round",
        "tracking.py",
        "return current + max_step if target > current else current - max_step",
        "return current - max_step if target <= current else current + max_step",
    ),
    SourceChange(
        "a product in another order",
        "tracking.py",
        "limits.angular_accel_rps2 * dt_s",
        "dt_s * limits.angular_accel_rps2",
    ),
    SourceChange(
        "a variable for the heading",
        "tracking.py",
        "    sinc = sin(error.theta) / error.theta if abs(error.theta) > 1e-6 else 1.0\n",
        "    theta = error.theta\n    sinc = sin(theta) / theta if abs(theta) > 1e-6 else 1.0\n",
    ),
    SourceChange(
        "an expression in place of a variable",
        "tracking.py",
        "    turning = reference.turning + reference.curvature * reference.linear\n"
        "    return Twist(reference.linear, turning)",
        "    return Twist(\n        reference.linear,\n"
        "        reference.turning + reference.curvature * reference.linear,\n    )",
    ),
    SourceChange(
        "another docstring",
        "speed_plan.py",
        '"""Return the plan of each segment."""',
        '"""Return how fast each segment may be driven."""',
    ),
    SourceChange(
        "a sum in place of a product",
        "drive.py",
        "2.0 * leg.accel * left",
        "(leg.accel + leg.accel) * left",
    ),
    SourceChange(
        "an assertion that holds",
        "drive.py",
        "    leg = legs[index]\n    end_speed = leg.last_end_speed if lap == laps - 1 else "
        "leg.end_speed\n    while lead",
        "    count = len(legs)\n    assert count\n    leg = legs[index]\n"
        "    end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed\n    while lead",
    ),
    SourceChange(
        "a comparison that reads the other way",
        "drive.py",
        "return 0 < self.laps <= self.progress.laps",
        "return self.laps > 0 and self.progress.laps >= self.laps",
    ),
    SourceChange("a square as a power", "drive.py", "cross_m * cross_m", "cross_m**2"),
    SourceChange(
        "keywords for positions",
        "drive.py",
        "held = Held(twist.linear, twist.angular, self.course.held.for_s, t_ns)",
        "held = Held(\n            linear_mps=twist.linear, angular_rps=twist.angular,\n"
        "            for_s=self.course.held.for_s, heard_t_ns=t_ns,\n        )",
    ),
    SourceChange(
        "an early return",
        "checks.py",
        "    if not health.odometry_fault or not odometry_lost(health, params, t_ns):\n"
        '        return ""\n',
        '    if not health.odometry_fault:\n        return ""\n'
        '    if not odometry_lost(health, params, t_ns):\n        return ""\n',
    ),
    SourceChange(
        "a variable for the age",
        "checks.py",
        "    return abs(t_ns - then_ns) / NS_PER_S\n",
        "    age_ns = abs(t_ns - then_ns)\n    return age_ns / NS_PER_S\n",
    ),
    SourceChange(
        "De Morgan",
        "odometry.py",
        "is_news = not fault and not is_repeated(health, odometry)",
        "is_news = not (fault or is_repeated(health, odometry))",
    ),
    SourceChange(
        "two independent lines change places",
        "kernel.py",
        "        stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, "
        "event.detail)\n"
        "        drive = None if state.drive is None else state.drive.from_standstill()\n",
        "        drive = None if state.drive is None else state.drive.from_standstill()\n"
        "        stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, "
        "event.detail)\n",
    ),
    SourceChange(
        "all() in place of and",
        "odometry.py",
        "    return (\n        isfinite(pose.x)\n        and isfinite(pose.y)\n"
        "        and isfinite(pose.theta)\n        and isfinite(velocity.linear)\n"
        "        and isfinite(velocity.angular)\n    )",
        "    numbers = (pose.x, pose.y, pose.theta, velocity.linear, velocity.angular)\n"
        "    return all(map(isfinite, numbers))",
    ),
    SourceChange(
        "a variable for the answer",
        "kernel.py",
        "            return False\n        self._refuse_for(lease, event)\n        return True",
        "            kept = False\n            return kept\n"
        "        self._refuse_for(lease, event)\n        return True",
    ),
    SourceChange(
        "a new function that nothing calls",
        "fence.py",
        "def left_by(",
        "def is_outside(x: float, y: float, corners: tuple[Corner, ...]) -> bool:\n"
        '    """Return whether a point lies outside the polygon."""\n'
        "    return not is_inside(x, y, corners)\n\n\ndef left_by(",
    ),
    SourceChange(
        "a comment",
        "geometry.py",
        "        c, s = cos(self.theta), sin(self.theta)\n        dx, dy",
        "        # By -theta.\n        c, s = cos(self.theta), sin(self.theta)\n        dx, dy",
    ),
    SourceChange(
        "a comparison that is negated",
        "state.py",
        "return level is not None and 0.0 <= level <= FULLEST_LEVEL",
        "return level is not None and level >= 0.0 and not level > FULLEST_LEVEL",
    ),
)

PACKAGE = Path(robotctl.__file__).parent

RUN = """
import os
from robotctl.cli.app import main
os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one process will do
main()
"""


@dataclass(frozen=True, slots=True)
class OtherRobotctl:
    """A robotctl whose kernel can be changed, and a history to judge with it."""

    tree: Path
    history: Path

    def gate(
        self, changes: Sequence[SourceChange], version: str = __version__
    ) -> tuple[int, dict[str, Any]]:
        """Change the kernel and run the gate; return exit code and answer."""
        module = self.tree / "robotctl/__init__.py"
        module.unlink(missing_ok=True)
        text = (PACKAGE / "__init__.py").read_text()
        module.write_text(text.replace(f'"{__version__}"', f'"{version}"'))
        kernel = self.tree / "robotctl/kernel"
        shutil.rmtree(kernel, ignore_errors=True)
        shutil.copytree(PACKAGE / "kernel", kernel)
        for change in changes:
            change.apply(kernel)
        ran = subprocess.run(
            # Without site and the working directory, no other robotctl comes first.
            [sys.executable, "-SP", "-c", RUN, "gate", "--in", str(self.history), "--json"],
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join([str(self.tree), *filter(None, sys.path)]),
                "PYTHONDONTWRITEBYTECODE": "1",
            },
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.stdout, ran.stderr
        answer = json.loads(ran.stdout)
        software = {each["software"] for each in answer["recordings"]}
        assert len(software) == 1
        assert software_hash() not in software
        return ran.returncode, answer


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> OtherRobotctl:
    folder = tmp_path_factory.mktemp("other")
    (folder / "tree/robotctl").mkdir(parents=True)
    for path in PACKAGE.iterdir():
        if path.name not in ("kernel", "__pycache__"):
            (folder / "tree/robotctl" / path.name).symlink_to(path)
    (folder / "history").mkdir()
    make_history(folder / "history")
    return OtherRobotctl(folder / "tree", folder / "history")


def each_of(changes: Sequence[SourceChange], quick: int) -> list[Any]:
    """Return the changes as parameters; all but the first ones are slow."""
    return [
        pytest.param(change, id=change.name, marks=[pytest.mark.slow] * (number >= quick))
        for number, change in enumerate(changes)
    ]


@pytest.mark.parametrize("change", each_of(REGRESSIONS, quick=3))
def test_a_regression_of_the_kernel_is_caught(other: OtherRobotctl, change: SourceChange) -> None:
    exit_code, answer = other.gate([change])
    assert (exit_code, answer["stored"]) == (7, 0), answer["counts"]


@pytest.mark.parametrize("change", each_of(HARMLESS, quick=0))
def test_a_harmless_change_passes(other: OtherRobotctl, change: SourceChange) -> None:
    exit_code, answer = other.gate([change])
    assert (exit_code, answer["stored"]) == (0, 0), answer["causes"]


def test_all_harmless_changes_together_pass(other: OtherRobotctl) -> None:
    exit_code, answer = other.gate(HARMLESS)
    assert (exit_code, answer["stored"]) == (0, 0), answer["causes"]


def test_a_regression_is_caught_although_another_version_recorded(other: OtherRobotctl) -> None:
    exit_code, answer = other.gate(REGRESSIONS[:1], version="9.9.9")
    assert exit_code == 7
    assert answer["counts"]["diverged"] == answer["failed"] > 0
    assert all(cause.startswith("diverged: after ") for cause in answer["causes"])
    assert f"(recorded by {__version__})" in str(answer["recordings"])


@pytest.mark.slow
def test_another_version_that_decides_the_same_passes(other: OtherRobotctl) -> None:
    exit_code, answer = other.gate(HARMLESS, version="9.9.9")
    assert exit_code == 0, answer["causes"]


def test_a_kernel_that_raises_fails_only_where_it_does(other: OtherRobotctl) -> None:
    change = SourceChange(
        "a fence asks odometry for what it does not have",
        "checks.py",
        "health.fence_origin, health.odometry.pose)",
        "health.fence_origin, health.odometry.place)",
    )
    exit_code, answer = other.gate([change])
    assert (exit_code, answer["failed"]) == (7, 1), answer["counts"]
    assert answer["counts"]["same"] == len(answer["recordings"]) - 1
    (cause,) = answer["causes"]
    assert "the kernel fails: AttributeError" in cause


def test_there_are_twenty_of_each() -> None:
    assert (len(set(REGRESSIONS)), len(set(HARMLESS))) == (20, 20)
