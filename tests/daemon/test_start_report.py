"""The report of a start, to a command that may have ended meanwhile."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from robotctl.daemon.start_report import StartReport
from robotctl.errors import RobotctlError


@pytest.fixture
def ended() -> Iterator[list[int]]:
    """The signals that end this process."""
    numbers: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: numbers.append(number))
    yield numbers
    signal.signal(signal.SIGTERM, before)


def report_without_reader() -> StartReport:
    reading, writing = os.pipe()
    os.close(reading)
    return StartReport(writing)


def test_a_daemon_that_no_command_waits_for_ends(ended: list[int]) -> None:
    report_without_reader().send({"ready": True})
    assert ended == [signal.SIGTERM]


def test_a_start_that_failed_keeps_its_exit_code(ended: list[int]) -> None:
    error = RobotctlError("no disk")
    assert report_without_reader().fail(error) == error.exit_code
    assert ended == []


def test_a_daemon_that_a_command_waits_for_goes_on(ended: list[int]) -> None:
    reading, writing = os.pipe()
    StartReport(writing).send({"ready": True})
    assert os.read(reading, 100) == b'{"ready": true}\n'
    os.close(reading)
    assert ended == []
