"""The recipe of docs/ros.md for networks without multicast: robot, operator and server."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from robotctl.kernel.modes import Mode
from tests.support.network import Host, network, peer_on
from tests.support.waiting import until
from tests.support.world import World, new_world

PAGE = Path(__file__).parents[2] / "docs" / "ros.md"
SERVER = "fastdds discovery -i 0 -l 0.0.0.0 -p 11811"
CLIENT = {
    "ROS_DISCOVERY_SERVER": "10.0.0.3:11811",
    "ROS_SUPER_CLIENT": "TRUE",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
}


@contextmanager
def server_on(host: Host) -> Iterator[None]:
    """Run the discovery server of the wheels."""
    binaries = Path(sys.executable).parent
    serving = subprocess.Popen(
        [*host.inside, *SERVER.split()],
        env={**os.environ, "PATH": f"{binaries}:{os.environ['PATH']}"},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # the tool is a shell script that starts others
    )
    with serving:
        assert serving.stdout is not None
        try:
            assert any("Server is running" in line for line in serving.stdout)
            yield
        finally:
            os.killpg(serving.pid, signal.SIGKILL)


def topics(world: World, host: Host) -> list[str]:
    """Return what `robotctl topic list` shows on a host."""
    world.inside = host.inside
    answer = json.loads(world.ok("topic", "list", "--domain-id", str(world.domain_id), "--json"))
    return [each["name"] for each in answer["topics"]]


def test_the_page_has_the_recipe_that_is_tested() -> None:
    page = PAGE.read_text()
    assert f"\n{SERVER}\n" in page
    assert [each for each in CLIENT.items() if f"export {'='.join(each)}\n" not in page] == []


@pytest.mark.slow
def test_three_hosts_without_multicast_meet_by_the_discovery_server() -> None:
    with ExitStack() as stack:
        robot, operator, third = stack.enter_context(network(3))
        for host in (robot, operator, third):
            host.run("ip", "link", "set", "eth0", "multicast", "off")
        world = stack.enter_context(new_world())
        client = {**CLIENT, "ROS_DISCOVERY_SERVER": f"{third.address}:11811"}
        world.inside, world.environment = robot.inside, {**world.environment, **client}
        stack.enter_context(server_on(third))
        world.ok("start", "--sim")
        far = stack.enter_context(peer_on(operator, world))
        far("send", kind="Twist", topic="/of_the_operator", count=3)
        until(
            lambda: any(
                each["name"] == "/of_the_operator" and each["count"] == 3
                for each in world.status()["topics"]
            )
        )
        assert not far("set_mode", mode=Mode.MOVING.value)["success"]
        assert "/odom" in topics(world, operator)
        del world.environment["ROS_DISCOVERY_SERVER"]
        assert "/odom" not in topics(world, operator), "it was the multicast"
        world.inside = robot.inside
        world.ok("stop")
