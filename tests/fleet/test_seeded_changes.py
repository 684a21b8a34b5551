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
from robotctl.fleet.software import software_hash
from tests.support.kernel_history import make_history
from tests.support.seeded_changes import HARMLESS, REGRESSIONS, SourceChange

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
