"""Parameters and log levels of a daemon: listed, read, changed and refused, each change told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.config import Config, flat, load
from robotctl.config.ros_settings import node_of
from tests.support.lines import Told
from tests.support.waiting import until
from tests.support.world import World, entries_of, world_with_daemon

OWN = {"start_type_description_service", "use_sim_time"}
"""The parameters that rclpy declares on each node."""


class Graph:
    """A world with one daemon, and a peer with a parameter client."""

    def __init__(self, world: World, peer: Told) -> None:
        self.world = world
        self.peer = peer

    def value(self, key: str) -> Any:
        """Return the value that the daemon's socket tells."""
        return self.world.answer_here("param", "get", key)["value"]


@pytest.fixture(scope="module")
def graph() -> Iterator[Graph]:
    with world_with_daemon() as world, world.peer("ParameterPeer") as peer:
        until(lambda: len(peer("visible")) >= 4)
        yield Graph(world, peer)


@pytest.fixture(scope="module")
def simulated(graph: Graph) -> World:
    return graph.world


def test_every_key_is_listed_with_its_declaration(simulated: World) -> None:
    listed = simulated.answer_here("param", "list")["parameters"]
    assert [each["key"] for each in listed] == list(flat(Config()))
    assert {each["key"]: each["default"] for each in listed} == flat(Config())
    (limit,) = (each for each in listed if each["key"] == "limits.linear_mps")
    assert limit == {
        "key": "limits.linear_mps",
        "value": 0.6,
        "default": 0.6,
        "type": "number",
        "allowed": "0.01 to 10 m/s",
        "changes": "while the robot stands",
        "about": "largest speed of a command",
    }
    assert all(each["about"] for each in listed)
    assert "limits.linear_mps" in simulated.ok("param", "list")
    assert simulated.ok("param", "get", "pattern.kind") == "square\n"


@pytest.mark.parametrize(
    ("key", "value", "exit_code", "said"),
    [
        ("limits.linear_mp", "1", 2, "limits.linear_mp: no such key: did you mean"),
        ("limits.linear_mps", "fast", 2, "'fast' is not allowed: use a number from 0.01 to 10"),
        ("limits.linear_mps", "-1", 2, "limits.linear_mps: -1.0 is not allowed: use 0.01 to 10"),
        ("limits.linear_mps", "nan", 2, "nan is not allowed"),
        ("battery.clear_level", "0.1", 2, "use at least battery.stop_level, 0.15"),
        ("rate_hz", "100", 4, "rate_hz changes at a start only"),
        ("sim.lag_s", "0.1", 4, "sim.lag_s changes at a start only"),
        ("recording.include", "/odom", 2, "use a list"),
    ],
)
def test_a_wrong_change_is_refused_by_name(
    simulated: World, key: str, value: str, exit_code: int, said: str
) -> None:
    before = simulated.answer_here("param", "list")
    simulated.here("param", "set", key, value).failed(exit_code, said)
    assert simulated.answer_here("param", "list") == before


def test_a_dump_is_a_configuration_file(simulated: World, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(simulated.ok("param", "dump"))
    values = {
        each["key"]: each["value"] for each in simulated.answer_here("param", "list")["parameters"]
    }
    assert flat(load(file)) == values


def test_each_visible_node_lists_its_keys_and_each_key_has_one_node(graph: Graph) -> None:
    listed = graph.peer("list_all")
    nodes = {"velocity_publisher", "odom_subscriber", "mode_service", "simulated_robot"}
    assert set(listed) == {f"/{name}" for name in nodes}
    for name in nodes:
        own = [key for key in flat(Config()) if node_of(key) == name]
        assert sorted({*own, *OWN}) == listed[f"/{name}"]
    declared = [key for keys in listed.values() for key in keys if key not in OWN]
    assert sorted(declared) == sorted(flat(Config()))


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("limits.linear_mp", 0.4, "/velocity_publisher has no parameter limits.linear_mp"),
        ("odometry.timeout_s", 0.4, "/velocity_publisher has no parameter odometry.timeout_s"),
        ("limits.linear_mps", "fast", "Wrong parameter type"),
        ("limits.linear_mps", 1, "Wrong parameter type"),
        ("limits.linear_mps", 11.0, "out of range"),
        ("limits.linear_mps", float("nan"), "out of range"),
        ("pattern.kind", "star", "use square, circle, figure-eight"),
        ("rate_hz", 100.0, "read-only"),
        ("command.frame_id", "base", "read-only"),
    ],
)
def test_a_wrong_change_gets_the_reason(graph: Graph, key: str, value: Any, why: str) -> None:
    ((granted, reason),) = graph.peer("set", node="/velocity_publisher", values={key: value})
    assert not granted
    assert why in reason


def test_a_change_by_a_service_and_one_by_the_command_line_are_seen_by_both(graph: Graph) -> None:
    node, key = "/velocity_publisher", "limits.angular_rps"
    assert graph.peer("set", node=node, values={key: 1.25}) == [[True, ""]]
    assert graph.value(key) == 1.25
    graph.world.ok("param", "set", key, "1.1")
    assert graph.peer("get", node=node, keys=[key]) == [1.1]
    until(lambda: len([e for e in graph.peer("events") if e[1] == key]) >= 2)
    assert [e for e in graph.peer("events") if e[1] == key] == [[node, key, 1.25], [node, key, 1.1]]


def test_several_values_are_set_all_or_none(graph: Graph) -> None:
    node = "/mode_service"
    both = {"battery.clear_level": 0.5, "battery.stop_level": 0.4}
    assert graph.peer("set", node=node, values=both, atomically=True) == [[True, ""]]
    wrong = {"battery.clear_level": 0.6, "battery.stop_level": 0.7}
    ((granted, reason),) = graph.peer("set", node=node, values=wrong, atomically=True)
    assert (granted, "use at least battery.stop_level" in reason) == (False, True)
    assert graph.value("battery.clear_level") == 0.5


def test_a_change_is_refused_by_name_while_the_robot_moves_and_recorded(graph: Graph) -> None:
    node, key = "/velocity_publisher", "limits.linear_mps"
    graph.world.ok("set-mode", "moving")
    ((granted, reason),) = graph.peer("set", node=node, values={key: 0.2})
    assert not granted
    assert reason.startswith(f"{key} does not change while the robot is MOVING")
    assert graph.peer("set", node=node, values={"pattern.size_m": 0.5}) == [[True, ""]]
    graph.world.ok("set-mode", "idle")
    assert graph.peer("set", node=node, values={key: 0.6}) == [[True, ""]]
    journal = entries_of(Path(graph.world.answer_here("record", "split")["finished"]))
    by = "by the ROS service /velocity_publisher/set_parameters"
    assert any(e.name == "ParameterChanged" and by[3:] in e.data for e in journal)
    assert by in graph.world.log()


def test_the_log_is_on_rosout_and_each_node_sets_its_level(graph: Graph) -> None:
    node = "/velocity_publisher"
    assert graph.peer("levels", node=node, names=["mode_service", ""]) == [0, 20]
    wanted = {"velocity_publisher": 10, "mode_service": 30, "rcl": 25}
    granted = graph.peer("set_levels", node=node, levels=wanted)
    assert granted == [[True, ""], [True, ""], [False, "Failed reason: Invalid logger level."]]
    told = "log level of mode_service: UNSET -> WARN, by the ROS service"
    line = [20, "mode_service", f"{told} /velocity_publisher/set_logger_levels"]
    until(lambda: line in graph.peer("lines"))
    published = [10, "velocity_publisher", "Publishing: linear.x=0.0, angular.z=0.0"]
    until(lambda: published in graph.peer("lines"))
    graph.world.ok("mark", "not told, because it is below the level")
    back = {"velocity_publisher": 0, "mode_service": 0}
    assert graph.peer("set_levels", node="/mode_service", levels=back) == [[True, ""]] * 2
    graph.world.ok("mark", "told")
    until(lambda: any(text.startswith("marked: told") for *_, text in graph.peer("lines")))
    assert not any("below the level" in text for *_, text in graph.peer("lines"))
    log = graph.world.log()
    assert (told in log, "below the level" in log) == (True, False)
    topics = {
        each["name"]: each["written"] + each["queued"] for each in graph.world.status()["topics"]
    }
    assert topics["/rosout"] >= 3


def test_a_limit_changes_between_drives_and_the_check_decides_across_it(simulated: World) -> None:
    simulated.ok("set-mode", "moving")
    simulated.here("param", "set", "limits.linear_mps", "0.2").failed(
        4, "limits.linear_mps does not change while the robot is MOVING: stop it"
    )
    assert simulated.ok("param", "set", "pattern.size_m", "0.8").endswith(" -> 0.8\n")
    simulated.ok("set-mode", "idle")
    answer = simulated.answer_here("param", "set", "limits.linear_mps", "0.2")
    assert (answer["old"], answer["new"]) == (0.6, 0.2)
    assert simulated.ok("param", "set", "on_recorder_failure", "warn")
    refused = simulated.here("drive", "circle", "--speed", "0.5")
    assert "0.5 m/s is above limits.linear_mps, 0.2 m/s" in refused.err
    simulated.ok("set-mode", "moving")
    until(lambda: (simulated.status()["velocity"] or {"linear": 0.0})["linear"] > 0.05)
    simulated.ok("set-mode", "idle")
    file = Path(simulated.answer_here("record", "split")["finished"])
    report = check_recording(file)
    assert report.verdict is Verdict.SAME, report.missing
    assert [entry.name for entry in entries_of(file)].count("ParameterChanged") >= 3
    assert "limits.linear_mps: 0.6 -> 0.2, by robotctl param set" in simulated.log()
