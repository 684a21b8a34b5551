"""The executor needs no other part of robotctl, and is loaded on first use only."""

from __future__ import annotations

from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

import robotctl.ros
from robotctl.ros import executor

RunPython = Callable[..., CompletedProcess[str]]

IMPORTED = """
import sys
{statement}
print(*sorted(name for name in sys.modules if name.split(".")[0] in ("robotctl", "rclpy")))
"""


def imported_by(run_python: RunPython, statement: str) -> set[str]:
    ended = run_python(IMPORTED.format(statement=statement))
    assert ended.returncode == 0, ended.stderr
    return set(ended.stdout.split())


def test_the_executor_needs_nothing_of_robotctl_but_its_own_parts(run_python: RunPython) -> None:
    names = imported_by(run_python, "from robotctl.ros import AsyncioExecutor, RawTap, Ticker")
    around = {"robotctl", "robotctl.ros", "robotctl.ros.executor"}
    own = {name for name in names if name.startswith("robotctl")}
    assert around < own
    assert {name for name in own - around if not name.startswith("robotctl.ros.executor.")} == set()


def test_the_package_and_the_ticker_are_imported_without_rclpy(run_python: RunPython) -> None:
    assert imported_by(run_python, "import robotctl.ros") == {"robotctl", "robotctl.ros"}
    names = imported_by(run_python, "from robotctl.ros import Ticker")
    assert "rclpy" not in names


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'NoSuchExecutor'"):
        _ = robotctl.ros.NoSuchExecutor


def test_every_name_of_the_face_is_there_and_in_the_other_face_the_same() -> None:
    named = {name: getattr(executor, name) for name in executor.__all__}
    assert len(named) == len(executor.__all__)
    for name in robotctl.ros.__all__:
        assert getattr(robotctl.ros, name) is named[name]


def test_the_ticker_and_the_errors_need_no_rclpy(run_python: RunPython) -> None:
    names = "Tick, Ticker, RclCallFailed, UnsupportedPlatform"
    assert "rclpy" not in imported_by(run_python, f"from robotctl.ros.executor import {names}")
