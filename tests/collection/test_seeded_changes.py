"""The gate catches regressions of the kernel, and lets harmless changes of its sources pass."""

from __future__ import annotations

import json
import os
import re
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
from robotctl.collection.judgement import software_hash
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


def changes(text: str) -> tuple[SourceChange, ...]:
    """Return the changes of a text: "FILE: NAME", then the lines before (-) and after (+)."""
    found = []
    for part in re.split(r"\n(?=\w)", text.rstrip("\n"))[1:]:
        title, *lines = part.split("\n")
        file, _, name = title.partition(": ")
        old, new = ("\n".join(each[2:] for each in lines if each[0] == sign) for sign in "-+")
        found.append(SourceChange(name, file, old, new))
    return tuple(found)


REGRESSIONS = changes(
    """
tracking.py: ramps are 1 % steeper
- limits.linear_accel_mps2 * dt_s
+ 1.01 * limits.linear_accel_mps2 * dt_s
tracking.py: a large error in heading counts less
- gains.k_theta * error.theta
+ gains.k_theta * aside
tracking.py: curvature is fed forward at the speed of the reference
- + reference.curvature * linear
+ + reference.curvature * reference.linear
drive.py: braking begins a little later
- brakes_from, half = end_speed * end_speed + 2.0 * leg.accel * left
+ brakes_from, half = end_speed * end_speed + 2.02 * leg.accel * left
checks.py: a lost odometry is noticed 20 ms later
- if age_s <= params.odometry.timeout_s:
+ if age_s <= params.odometry.timeout_s + 0.02:
odometry.py: a jump of odometry is believed
- if jump_m > params.max_jump_m:
+ if jump_m > 10.0 * params.max_jump_m:
checks.py: a drained battery releases the stop
- (is_level(level) and level >= clear_level)
+ is_level(level)
kernel.py: an operator's stop is not latched
- self._effects.append(LatchEmergencyStop(reason, cause))
+ if cause is not Cause.OPERATOR_STOP:
+                 self._effects.append(LatchEmergencyStop(reason, cause))
kernel.py: the lease keeps nobody away
- if lease is None or lease.client == event.client:
+ if lease is None or lease.client != 0:
kernel.py: the reference goes on through a stall
- drive = None if state.drive is None else state.drive.from_standstill()
+ drive = state.drive
"""
)

HARMLESS = changes(
    '''
tracking.py: the sign is compared
- return copysign(bound, value) if isfinite(value) else 0.0
+ return (bound if value > 0.0 else -bound) if isfinite(value) else 0.0
tracking.py: a product in another order
- limits.angular_accel_rps2 * dt_s
+ dt_s * limits.angular_accel_rps2
tracking.py: a variable for the heading
-     sinc = aside / error.theta if abs(error.theta) > 1e-6 else 1.0
+     theta = error.theta
+     sinc = aside / theta if abs(theta) > 1e-6 else 1.0
drive.py: a sum in place of a product
- 2.0 * leg.accel * left
+ (leg.accel + leg.accel) * left
drive.py: an assertion that holds
-     leg = legs[index]
-     end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
-     while lead
+     count = len(legs)
+     assert count
+     leg = legs[index]
+     end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
+     while lead
checks.py: an early return
-     if not health.odometry_fault or not odometry_lost(health, params, t_ns):
-         return ""
+     if not health.odometry_fault:
+         return ""
+     if not odometry_lost(health, params, t_ns):
+         return ""
kernel.py: two independent lines change places
-         stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, event.detail)
-         drive = None if state.drive is None else state.drive.from_standstill()
+         drive = None if state.drive is None else state.drive.from_standstill()
+         stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, event.detail)
fence.py: a new function that nothing calls
- def left_by(
+ def is_outside(x: float, y: float, corners: tuple[Corner, ...]) -> bool:
+     """Return whether a point lies outside the polygon."""
+     return not is_inside(x, y, corners)
+
+
+ def left_by(
geometry.py: a comment
-         c, s = direction(self.theta)
-         dx, dy
+         # By -theta.
+         c, s = direction(self.theta)
+         dx, dy
state.py: a comparison that is negated
- return level is not None and 0.0 <= level <= FULLEST_LEVEL
+ return level is not None and level >= 0.0 and not level > FULLEST_LEVEL
'''
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


@pytest.mark.slow  # one of them is in the quick run: another version recorded there
@pytest.mark.parametrize("change", REGRESSIONS, ids=[each.name for each in REGRESSIONS])
def test_a_regression_of_the_kernel_is_caught(other: OtherRobotctl, change: SourceChange) -> None:
    exit_code, answer = other.gate([change])
    assert (exit_code, answer["stored"]) == (7, 0), answer["counts"]


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
