"""Settings of the middleware that do not do what they seem to do are named; others are not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robotctl.doctor.machine import (
    Finding,
    Level,
    check_middleware,
    check_profiles,
    check_range,
    check_shell,
)
from robotctl.environment import RMW

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"


def only(found: list[Finding]) -> Finding:
    (one,) = found
    assert one.level is Level.WARNING
    assert one.cure
    return one


def test_another_middleware_is_named_and_is_no_other_ros() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    assert "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp" in only([*check_middleware(environment)]).text
    assert [each.level for each in check_shell(environment, Path("/venv"))] == [Level.OK]
    for given in ({}, {"RMW_IMPLEMENTATION": ""}, {"RMW_IMPLEMENTATION": RMW}):
        assert [*check_middleware(given)] == []


@pytest.mark.parametrize(
    ("discovery", "localhost_only", "text"),
    [
        ("subnet", "0", "'subnet', which ROS does not know: it takes LOCALHOST"),
        ("OFF", "0", "no process discovers another"),
        ("SUBNET", "1", "overrules ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"),
    ],
)
def test_a_range_that_hides_processes_is_named(
    discovery: str, localhost_only: str, text: str
) -> None:
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
        "ROS_LOCALHOST_ONLY": localhost_only,
    }
    assert text in only([*check_range(environment)]).text


@pytest.mark.parametrize("discovery", ["", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"])
def test_a_range_of_ros_gives_no_alarm(discovery: str) -> None:
    assert [*check_range({"ROS_AUTOMATIC_DISCOVERY_RANGE": discovery})] == []
    assert [*check_range({"ROS_LOCALHOST_ONLY": "1"})] == []


def test_a_profiles_file_that_has_no_effect_is_named(tmp_path: Path) -> None:
    file = tmp_path / "fast.xml"
    environment = {PROFILES: str(file)}
    assert "No such file" in only([*check_profiles(environment)]).text
    file.write_text("profiles: yes")
    assert "it is no XML" in only([*check_profiles(environment)]).text
    file.write_text("<dds><profiles/></dds>")
    assert [*check_profiles(environment)] == []
    assert [*check_profiles({})] == []
    os.mkfifo(tmp_path / "pipe")
    for no_file in ("", str(tmp_path), str(tmp_path / "pipe"), "/dev/zero"):
        assert only([*check_profiles({PROFILES: no_file})]).check == "profiles"
