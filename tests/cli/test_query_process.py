"""A look at ROS starts before the option parser does, and its answer does not wait for its end."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.cli.support import early_process, query_process
from robotctl.cli.support.query_process import query_processes
from robotctl.cli.support.ros_view import RosView
from robotctl.paths import socket_path

LINGERING = """
import os, sys
asked = sys.stdin.readline()
os.write(3, asked.encode())
sys.stdin.read()
os.read(os.open(sys.argv[1], os.O_RDONLY), 1)
"""
"""Reports what it was asked for; ends when it is told to by a FIFO."""


class Started:
    """Children that are never started."""

    def __init__(self) -> None:
        self.count = 0
        self.killed = 0

    def __call__(self, *_: object, **__: object) -> Any:
        self.count += 1
        return self

    def kill(self) -> None:
        self.killed += 1

    def close(self, _: float) -> None:
        assert self.killed


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    made = Started()
    monkeypatch.setattr(early_process, "start", made)
    monkeypatch.setattr(early_process, "fork", made)
    yield made
    assert made.killed == made.count


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("service call /set_mode", 1),
        ("topic echo /odom x --once", 1),
        ("topic hz --robot r2 /odom", 1),
        ("topic list", 1),
        ("node info /mode_service --json", 1),
        ("service list --robot r2", 0),
        ("service list --robot r2 --domain-id=5", 1),
        ("topic list --file last", 0),
        ("topic echo --file=last /odom", 0),
        ("topic echo --help", 0),
        ("topic", 0),
        ("topic sing", 0),
    ],
)
def test_the_process_starts_early_where_the_line_needs_it(
    started: Started, line: str, count: int
) -> None:
    with query_processes(line.split()):
        assert started.count == count


def test_where_a_daemon_answers_no_process_is_started_for_a_list(started: Started) -> None:
    socket = socket_path("robot")
    socket.parent.mkdir(parents=True)
    socket.touch()
    with query_processes(["topic", "list"]):
        assert started.count == 0
    with query_processes(["topic", "list", "--domain-id", "3"]):
        assert started.count == 1


def test_an_answer_comes_before_the_process_has_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    look, fifo = tmp_path / "look.py", tmp_path / "fifo"
    look.write_text(LINGERING)
    os.mkfifo(fifo)
    monkeypatch.setattr(early_process, "program", lambda _: (sys.executable, str(look), str(fifo)))
    monkeypatch.setattr(early_process, "has_one_thread", lambda: False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    with query_processes(["topic", "list", "--domain-id", "7"]):
        answer: Any = RosView("robot", "", 7, through_daemon=False).names()
        assert answer == {"look": "names", "domain_id": 7, "range": "SUBNET"}
        (child,) = query_process._leaving
        assert child.wait(0.0) is None
        with fifo.open("w") as end:
            end.write("x")
    assert child.wait(0.0) == 0
