"""The levels of the daemon's loggers: as rclpy has them, bounded, and each change is told."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from robotctl.daemon.log.levels import MAX_NAME_LENGTH, MAX_NAMES, LoggerLevels
from robotctl.log_levels import LogLevel

OURS = logging.getLogger("robotctl.daemon.driver")


@pytest.fixture
def levels() -> Iterator[LoggerLevels]:
    """Levels where node `r2.modes` owns the loggers of our modules; they end with the test."""
    root = logging.getLogger()
    before = root.level
    root.setLevel(logging.INFO)
    made = LoggerLevels("r2.modes")
    yield made
    root.setLevel(before)
    for name in made.named:
        logging.getLogger("robotctl" if name == made.own else name or None).setLevel(0)
    root.setLevel(before)


def test_the_node_that_owns_the_log_sets_the_level_of_all_our_modules(levels: LoggerLevels) -> None:
    assert levels.name_of(OURS.name) == "r2.modes"
    assert levels.name_of("asyncio") == "asyncio"
    levels.set("r2.modes", 10, "a test")
    assert OURS.isEnabledFor(logging.DEBUG)
    assert (levels.get("r2.modes"), levels.get("robotctl")) == (10, 10)
    levels.set("r2.modes", 0, "a test")
    assert not OURS.isEnabledFor(logging.DEBUG)


def test_an_unset_level_is_0_and_that_of_all_loggers_is_info(levels: LoggerLevels) -> None:
    assert levels.get("never.heard.of") == 0
    assert "never.heard.of" not in logging.root.manager.loggerDict
    assert levels.get("") == 20
    levels.set("", 40, "a test")
    assert (levels.get(""), OURS.isEnabledFor(logging.WARNING)) == (40, False)
    levels.set("", 0, "a test")
    assert levels.get("") == 20


@pytest.mark.parametrize("level", [5, 25, 51, 255])
def test_another_number_is_no_level(levels: LoggerLevels, level: int) -> None:
    assert levels.refusal("robotctl", level) == "Failed reason: Invalid logger level."


def test_callers_cannot_fill_the_memory_with_names(levels: LoggerLevels) -> None:
    for number in range(MAX_NAMES):
        assert levels.refusal(f"made_up.{number}", 10) == ""
        levels.set(f"made_up.{number}", 10, "a test")
    assert "have a level already" in levels.refusal("one.more", 10)
    assert levels.refusal("made_up.0", 20) == ""
    assert "characters" in levels.refusal("x" * (MAX_NAME_LENGTH + 1), 10)


def test_each_change_is_told_also_where_nothing_else_is(
    levels: LoggerLevels, caplog: pytest.LogCaptureFixture
) -> None:
    service = "the ROS service /r2/modes/set_logger_levels"
    levels.set("", 50, service)
    levels.set("", 50, "somebody who changes nothing")
    levels.apply([LogLevel("rcl\x1b", 10), LogLevel("", 20)])
    assert caplog.messages == [
        "log level of all loggers: INFO -> FATAL, by the ROS service /r2/modes/set_logger_levels",
        r"log level of rcl\x1b: UNSET -> DEBUG, by the command line",
        "log level of all loggers: FATAL -> INFO, by the command line",
    ]
