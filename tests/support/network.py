"""Hosts of a network of their own: Linux network namespaces, joined by a bridge.

Each has its own addresses, ports and shared memory. A host lasts as long as its holder, which ends
with this process, so that nothing outlives a killed test.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

import pytest

from tests.support.world import Peer, World

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
