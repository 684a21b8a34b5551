"""What others announce on the graph changes nothing for a daemon that drives."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from robotctl.testing.lines import Told
from robotctl.testing.waiting import until
from robotctl.testing.world import World

STRANGE = [
    ("/types/main", "lib2to3/__main__/X"),
    ("/types/browser", "antigravity/x/X"),
    ("/types/module", "os.path/msg/X"),
    ("/types/own", "robot_controller/__main__/X"),
    ("/types/bytes", "std_msgs/msg/\xff\x1b[31m"),
    ("/my-topic", "std_msgs/msg/String"),
    ("/bad\xff\x1b[31m", "std_msgs/msg/String"),
]


@pytest.fixture
def hostile(world: World) -> Iterator[Told]:
    """A process that does not validate what it announces."""
    told = Told([sys.executable, "-m", "robotctl.testing.hostile_peer"], world.environment)
    yield told
    told.close()


def test_the_daemon_drives_on_and_names_what_it_does_not_record(
    world: World, hostile: Told
) -> None:
    world.ok("start", "--sim", "--drive", "square")
    for topic, type_name in STRANGE:
        hostile("offer", topic=topic, type_name=type_name)
    until(lambda: sum("is not recorded" in text for text in world.status()["warnings"]) == 7)
    hostile("rename", name="\xff", namespace="/\xfe")
    status = world.status()
    assert status["mode"] == "MOVING"
    assert all(text.isprintable() for text in status["warnings"])
    shown = world.ok("status")
    assert "\x1b" not in shown
    assert "/my-topic is not recorded: ROS does not allow its name" in " ".join(shown.split())
    world.ok("stop")
    assert "Traceback" not in world.log()
    assert "\x1b" not in world.log()
