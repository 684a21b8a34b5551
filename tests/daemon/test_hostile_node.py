"""False announcements on the ROS graph do not affect a daemon that drives."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.lines import Told, peer_command
from tests.support.waiting import until
from tests.support.world import Peer, World

STRANGE = [
    ("/types/main", "lib2to3/__main__/X"),
    ("/types/browser", "antigravity/x/X"),
    ("/types/module", "os.path/msg/X"),
    ("/types/own", "robot_controller/__main__/X"),
    ("/types/bytes", "std_msgs/msg/\xff\x1b[31m"),
    ("/my-topic", "std_msgs/msg/String"),
    ("/bad\xff\x1b[31m", "std_msgs/msg/String"),
]

TOO_LARGE = 160_000_000
"""Bytes of a message that exceeds the recorder's queue."""


@pytest.fixture
def hostile(world: World) -> Iterator[Told]:
    """A process that announces invalid data."""
    told = Told(peer_command("tests.support.hostile_peer"), world.environment)
    yield told
    told.close()


def test_the_daemon_drives_on_and_names_what_it_does_not_record(
    world: World, hostile: Told
) -> None:
    world.ok("start", "--sim", "--drive", "square")
    for topic, type_name in STRANGE:
        hostile("offer", topic=topic, type_name=type_name)
    until(lambda: sum("is not recorded" in text for text in world.status()["warnings"]) == 7)
    hostile("rename", name="\xff\x1b[31m", namespace="/\xfe")
    status = world.status()
    assert status["mode"] == "MOVING"
    assert all(text.isprintable() for text in status["warnings"])
    shown = world.ok("status")
    assert "\x1b" not in shown
    assert "/my-topic is not recorded: ROS does not allow its name" in " ".join(shown.split())
    world.ok("stop")
    assert "Traceback" not in world.log()
    assert "\x1b" not in world.log()


def test_each_publisher_of_commands_is_named_even_with_a_strange_name(
    world: World, hostile: Told
) -> None:
    world.ok("start", "--sim")
    hostile("offer", topic="/cmd_vel", type_name="std_msgs/msg/\xff")

    name = r"/\xfe/\xff\x1b[31m"

    def is_named() -> bool:
        hostile("rename", name="\xff\x1b[31m", namespace="/\xfe")
        return any(name in text for text in world.status()["warnings"])

    until(is_named)
    ran = world.robotctl("set-mode", "moving")
    assert ran.exit_code == 4
    assert name in ran.err
    assert world.status()["mode"] == "IDLE"
    world.ok("stop")
    assert "Traceback" not in world.log()


def test_a_message_that_is_too_large_is_counted_and_its_memory_given_back(
    world: World, new_peer: Callable[[World], Peer]
) -> None:
    world.ok("start", "--sim")
    pid = world.status()["pid"]
    before = resident_bytes(pid)
    new_peer(world)("send_large", topic="/large", size=TOO_LARGE)
    until(lambda: world.status()["recorder"]["dropped"] == 1)
    # The middleware keeps one buffer of the size of the largest message.
    assert resident_bytes(pid) - before < 1.5 * TOO_LARGE
    world.ok("stop")


def resident_bytes(pid: int) -> int:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
