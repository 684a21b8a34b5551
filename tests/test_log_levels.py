"""`--log-level` takes what ROS takes, and names what it does not."""

from __future__ import annotations

import pytest

from robotctl.base.errors import UsageError
from robotctl.base.ros_arguments import LogLevel, level_name, parse, read_log_level, with_log_levels


@pytest.mark.parametrize(
    ("text", "level"),
    [
        ("debug", LogLevel("", 10)),
        ("WARN", LogLevel("", 30)),
        ("r2.mode_service:=fatal", LogLevel("r2.mode_service", 50)),
    ],
)
def test_a_level_is_for_all_loggers_or_for_a_named_one(text: str, level: LogLevel) -> None:
    assert read_log_level(text) == level


@pytest.mark.parametrize("text", ["", "loud", "warning", "10", ":=debug", "rcl:=", "rcl=debug"])
def test_another_level_is_named_with_those_that_are_allowed(text: str) -> None:
    with pytest.raises(UsageError, match="use debug, info, warn, error, fatal, or LOGGER:=LEVEL"):
        read_log_level(text)


def test_a_level_between_two_names_has_the_lower_one() -> None:
    assert [level_name(level) for level in (0, 9, 10, 25, 99)] == [
        *("UNSET", "UNSET", "DEBUG", "INFO", "FATAL")
    ]


def test_an_executable_hands_its_levels_to_rcl() -> None:
    line = ["odom_subscriber", "--log-level", "debug", "--log-level=rcl:=warn"]
    rest = ["--ros-args", "-p", "a:=1", "--log-level", "error"]
    expected = [*rest, "--ros-args", "--log-level", "debug", "--log-level", "rcl:=warn"]
    assert with_log_levels([*line, *rest]) == ["odom_subscriber", *expected]
    assert with_log_levels(rest) == rest
    with pytest.raises(UsageError, match="--log-level '' is not allowed"):
        with_log_levels(["odom_subscriber", "--log-level"])


def test_a_level_among_the_ros_arguments_is_read() -> None:
    levels = parse(["--log-level", "info", "--log-level", "rcl:=debug"]).log_levels
    assert levels == (LogLevel("", 20), LogLevel("rcl", 10))
    with pytest.raises(UsageError, match="--log-level 'loud' is not allowed"):
        parse(["--log-level", "loud"])
