"""Robots side by side, by namespace and by domain: none hears what is meant for another.

Between two hosts: motion is refused to the other one, a stop never.
The recipe of docs/ros.md for networks without multicast: robot, operator and server.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from robotctl.base.domains import reserved_domain
from robotctl.kernel.modes import Mode
from tests.support.waiting import until
from tests.support.world import Peer, World, new_world

HOLDER = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec cat"


@dataclass(frozen=True, slots=True)
class Host:
    """One host: its address, and what a command line begins with to run there."""

    address: str
    inside: tuple[str, ...]

    def run(self, *command: str) -> None:
        """Run a command there, which must succeed."""
        subprocess.run((*self.inside, *command), check=True, capture_output=True)


@contextmanager
def network(count: int) -> Iterator[list[Host]]:
    """Make so many hosts that reach each other, or skip the test where that is not possible."""
    with ExitStack() as stack:
        switch = stack.enter_context(_host("", "--net"))
        switch.run("ip", "link", "add", "bridge", "type", "bridge", "mcast_snooping", "0")
        switch.run("ip", "link", "set", "bridge", "up")
        hosts = []
        for number in range(1, count + 1):
            host = stack.enter_context(_host(f"10.77.0.{number}", "--net", "--mount"))
            pid, port = host.inside[2], f"port{number}"
            peer = ("peer", "name", "eth0", "netns", pid)
            switch.run("ip", "link", "add", port, "type", "veth", *peer)
            switch.run("ip", "link", "set", port, "master", "bridge", "up")
            host.run("ip", "address", "add", f"{host.address}/24", "dev", "eth0")
            host.run("ip", "link", "set", "eth0", "up")
            hosts.append(host)
        yield hosts


@contextmanager
def peer_on(host: Host, world: World, **variables: str) -> Iterator[Peer]:
    """Start a ROS process on a host, with variables beside those of the world."""
    inside, environment = world.inside, world.environment
    world.inside, world.environment = host.inside, {**environment, **variables}
    try:
        peer = Peer(world)
    finally:
        world.inside, world.environment = inside, environment
    with closing(peer):
        yield peer


@contextmanager
def _host(address: str, *kinds: str) -> Iterator[Host]:
    """Make a host; `kinds` are the namespaces that it does not share with this process."""
    pipe = subprocess.PIPE
    command = ("unshare", *kinds, "sh", "-c", HOLDER if "--mount" in kinds else "echo ready; cat")
    try:
        holder = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    except FileNotFoundError:
        pytest.skip("network namespaces need unshare of util-linux")
    with holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        assert holder.stderr is not None
        try:
            if holder.stdout.readline() != "ready\n":
                pytest.skip(f"no network namespaces here: {holder.stderr.read().strip()}")
            yield Host(address, ("nsenter", "-t", str(holder.pid), *kinds, "--"))
        finally:
            holder.stdin.close()


@pytest.mark.slow
def test_robots_of_two_namespaces_and_of_two_domains_do_not_disturb_each_other() -> None:
    with ExitStack() as stack:
        world = stack.enter_context(new_world())
        own_domain = str(stack.enter_context(reserved_domain()))
        world.ok("start", "--sim")
        world.ok("start", "--sim", "--robot", "r2")
        world.ok("start", "--sim", "--robot", "r3", "--namespace", "/", "--domain-id", own_domain)
        peer = stack.enter_context(closing(Peer(world)))

        def modes() -> list[str]:
            return [world.status(robot)["mode"] for robot in ("robot", "r2", "r3")]

        assert peer("set_mode", mode=Mode.MOVING.value)["success"]
        assert modes() == ["MOVING", "IDLE", "IDLE"]
        until(lambda: world.status()["pose"]["x"] > 0.2)
        assert [world.status(robot)["pose"]["x"] for robot in ("r2", "r3")] == [0.0, 0.0]
        assert peer("set_mode", mode=Mode.MOVING.value, namespace="/r2")["success"]
        world.ok("estop")
        assert modes() == ["EMERGENCY_STOP", "MOVING", "IDLE"]
        world.ok("drive", "circle", "--robot", "r3")
        assert peer("answer", number=peer("ask", service="estop", namespace="/r2"))["success"]
        assert modes() == ["EMERGENCY_STOP", "EMERGENCY_STOP", "MOVING"]
        for robot in ("robot", "r2", "r3"):
            assert [each for each in world.status(robot)["warnings"] if "publish" in each] == []
            world.ok("stop", "--robot", robot)


STATIC = "ROS_STATIC_PEERS"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.mark.parametrize("discovery", [pytest.param("SUBNET", marks=pytest.mark.slow), "LOCALHOST"])
def test_only_the_robots_own_computer_starts_motion_and_everybody_stops_it(discovery: str) -> None:
    """A daemon in LOCALHOST is reached by who names its host as a static peer."""
    with ExitStack() as stack:
        here, there = stack.enter_context(network(2))
        world = stack.enter_context(new_world())
        world.inside = here.inside
        world.environment[RANGE] = discovery
        world.ok("start", "--sim")
        elsewhere = {RANGE: "SUBNET", STATIC: here.address}
        remote = stack.enter_context(peer_on(there, world, **elsewhere))
        refused = remote("set_mode", mode=Mode.MOVING.value)
        assert not refused["success"]
        assert "was called from another host" in refused["message"]
        own = stack.enter_context(peer_on(here, world))
        until(lambda: own("set_mode", mode=Mode.MOVING.value)["success"])
        assert remote("set_mode", mode=Mode.IDLE.value)["success"]
        assert own("set_mode", mode=Mode.MOVING.value)["success"]
        assert remote("answer", number=remote("ask", service="estop"))["success"]
        assert world.status()["mode"] == "EMERGENCY_STOP"
        world.ok("stop")


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
