"""Parameters of a running daemon: listed, read, changed and refused, on the command line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.config import Config, flat, load
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from tests.support.waiting import until
from tests.support.world import World, entries_of, new_world


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    """A world with one daemon, which simulates its robot."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")


def test_every_key_is_listed_with_its_declaration(world: World) -> None:
    listed = world.answer("param", "list")["parameters"]
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
    assert "limits.linear_mps" in world.ok("param", "list")
    assert world.ok("param", "get", "pattern.kind") == "square\n"


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
    world: World, key: str, value: str, exit_code: int, said: str
) -> None:
    before = world.answer_here("param", "list")
    ran = world.here("param", "set", key, value)
    assert ran.exit_code == exit_code, ran
    assert said in ran.err
    assert world.answer_here("param", "list") == before


def test_an_unknown_key_is_refused_by_get(world: World) -> None:
    ran = world.robotctl("param", "get", "limits.linear_mp")
    assert (ran.exit_code, "did you mean limits.linear_mps?" in ran.err) == (2, True)


def test_a_limit_changes_between_two_drives_and_the_check_decides_across_it(world: World) -> None:
    world.ok("set-mode", "moving")
    refused = world.robotctl("param", "set", "limits.linear_mps", "0.2")
    assert refused.exit_code == 4
    assert "limits.linear_mps does not change while the robot is MOVING: stop it" in refused.err
    assert world.ok("param", "set", "pattern.size_m", "0.5") == "pattern.size_m: 1.0 -> 0.5\n"
    world.ok("set-mode", "idle")
    answer = world.answer("param", "set", "limits.linear_mps", "0.2")
    assert (answer["old"], answer["new"]) == (0.6, 0.2)
    assert world.ok("param", "set", "on_recorder_failure", "warn")
    refused = world.robotctl("drive", "circle", "--speed", "0.5")
    assert "0.5 m/s is above limits.linear_mps, 0.2 m/s" in refused.err
    first = Path(world.answer("record", "split")["finished"])
    world.ok("set-mode", "moving")
    until(lambda: (world.status()["velocity"] or {"linear": 0.0})["linear"] > 0.05)
    world.ok("set-mode", "idle")
    second = Path(world.answer("record", "split")["finished"])
    for file in (first, second):
        report = check_recording(file)
        assert report.verdict is Verdict.SAME, report
    journal = [entry for file in (first, second) for entry in entries_of(file)]
    assert [e.name for e in journal].count("ParameterChanged") >= 3
    assert "limits.linear_mps: 0.6 -> 0.2, by robotctl param set" in world.log()


def test_a_dump_is_a_configuration_file(world: World, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(world.ok("param", "dump"))
    values = {each["key"]: each["value"] for each in world.answer("param", "list")["parameters"]}
    assert flat(load(file)) == values
