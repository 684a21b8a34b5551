"""The launch file starts the daemon, with the names that launch really has.

`launch` of ROS is on no package index (the `launch` there is another project), so the file runs
against a stand-in made from a table of its real names. Where launch itself can be imported, the
table is compared with it.
"""

from __future__ import annotations

import inspect
import runpy
import signal
import subprocess
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import UsageError
from robotctl.base.paths import check_namespace
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from tests.launch.stand_in import Made, classes, stand_in
from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import installed, new_world

ROOT = Path(__file__).parents[2]
FILE = ROOT / "launch" / "robot_controller.launch.py"
ROLES = ("velocity_publisher", "odom_subscriber", "mode_service")


def launched(**arguments: str) -> list[Made]:
    """The processes that the launch file starts for these arguments."""
    with stand_in():
        declared, opaque = description()
        given = {each.given["name"]: each.given["default_value"] for each in declared}
        assert set(arguments) <= set(given)
        found: list[Made] = opaque.given["function"]({**given, **arguments})
    return found


def description() -> tuple[list[Made], Made]:
    """The declared arguments, and the function that makes the processes."""
    entities = runpy.run_path(str(FILE))["generate_launch_description"]().given["initial_entities"]
    return entities[:-1], entities[-1]


def told(process: Made) -> tuple[Any, ...]:
    """What is started, and with which words."""
    executable, *words = process.given["cmd"]
    return (executable.given["executable"], *words)


def test_the_arguments_and_their_defaults_are_the_documented_ones() -> None:
    with stand_in():
        declared, _ = description()
    assert {each.given["name"]: each.given["default_value"] for each in declared} == {
        "use_sim_time": "false",
        "robot_name": "robot",
        "namespace": "",
        "params_file": "",
        "sim": "auto",
        "single_process": "true",
        "respawn": "false",
    }
    for each in declared:
        choices = each.given.get("choices")
        assert choices is None or each.given["default_value"] in choices


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, ()),
        ({"sim": "true"}, ("--sim",)),
        ({"sim": "false"}, ("--no-sim",)),
        ({"params_file": "/a.yaml"}, ("--config", "/a.yaml")),
        ({"namespace": "/fleet/r1"}, ("--namespace", "/fleet/r1")),
    ],
)
def test_a_single_process_is_the_daemon(arguments: dict[str, str], words: tuple[str, ...]) -> None:
    (daemon,) = launched(**arguments)
    assert told(daemon) == ("robotctl", "start", "--foreground", "--robot", "robot", *words)


def test_one_process_a_role_is_retired_and_the_daemon_starts() -> None:
    told_so, daemon = launched(single_process="false", use_sim_time="true", respawn="true")
    lines = [f"ros2 run robot_controller {name}" for name in ROLES]
    assert all(line in told_so.given["msg"] for line in lines)
    time = ("--ros-args", "-p", "use_sim_time:=true")
    assert told(daemon) == ("robotctl", "start", "--foreground", "--robot", "robot", *time)
    assert daemon.given["respawn"] is True


def test_every_process_has_time_for_its_last_zero_before_it_is_killed() -> None:
    (daemon,) = launched()
    assert float(daemon.given["sigterm_timeout"]) >= 10.0
    assert float(daemon.given["sigkill_timeout"]) >= 10.0


def test_the_table_is_what_launch_itself_offers() -> None:
    """Not run where launch is missing, as with the wheels."""
    pytest.importorskip("launch.actions")
    pytest.importorskip("launch_ros.actions")
    for full, table in classes().items():
        place, _, name = full.rpartition(".")
        taken: set[str] = set()
        for each in inspect.getmro(getattr(import_module(place), name)):
            if "__init__" in vars(each):
                taken |= set(inspect.signature(vars(each)["__init__"]).parameters)
        assert {*table.get("positional", []), *table.get("keywords", [])} <= taken, full


def test_ctrl_c_of_the_launched_daemon_ends_with_a_closed_recording() -> None:
    (daemon,) = launched(sim="true")
    executable, *words = told(daemon)
    with new_world() as world:
        with (world.folder / "launched.log").open("w") as log:
            process = subprocess.Popen(
                [installed(executable), *words],
                cwd=world.folder,
                env=world.environment,
                stdout=log,
                stderr=log,
            )
        until(lambda: '"ready": true' in (world.folder / "launched.log").read_text())
        assert world.robotctl("set-mode", "moving").exit_code in (0, 4)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=2 * DEADLINE_S) == 0
        assert check_recording(world.recording).verdict is Verdict.SAME


def test_sim_auto_ends_where_odometry_is_published_in_its_namespace() -> None:
    robot = ("--robot", "r1", "--namespace", "/fleet/r1")
    with new_world() as world:
        simulated = world.spawn("sim", *robot)
        assert line_of(simulated.stdout).startswith("simulated robot r1 runs")
        assert world.robotctl("sim", *robot, "--auto").exit_code == 0
        simulated.send_signal(signal.SIGINT)
        assert simulated.wait(timeout=2 * DEADLINE_S) == 0


@pytest.mark.parametrize(
    ("text", "namespace"), [("", ""), ("/", ""), ("r1", "/r1"), ("/fleet/r1/", "/fleet/r1")]
)
def test_a_namespace_is_taken_in_every_spelling(text: str, namespace: str) -> None:
    assert check_namespace(text) == namespace


@pytest.mark.parametrize("text", ["a b", "/1", "/a//b", "/a__b", "/\n", "/é"])
def test_no_other_text_is_a_namespace(text: str) -> None:
    with pytest.raises(UsageError, match="use /NAME or /A/B"):
        check_namespace(text)
