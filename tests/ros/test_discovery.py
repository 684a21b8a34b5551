"""A wait for discovery ends when all processes of the domain are completely discovered.

A process joins a ROS domain, creates no files in the user's home, and leaves the domain.
"""

from __future__ import annotations

import os
import signal
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Self

import pytest
from rclpy.node import Node
from std_msgs.msg import String

from robotctl.ros.context import Membership
from robotctl.ros.graph.discovery import (
    FoundEndpoint,
    Introduction,
    count_complete,
    read_introduction,
)
from tests.support.lines import Told, peer_command, run_python
from tests.support.ros_peer import node_in
from tests.support.waiting import DEADLINE_S

TOPICS = [f"/topic_{number}" for number in range(20)]
OURS, THEIRS = bytes(12), bytes([1] * 12)
WRITER, READER, HELLO = b"\0\0\4\3", b"\0\0\5\4", b"\0\0\6\3"


@pytest.fixture
def others(domain_id: int) -> Iterator[Node]:
    """A node with many subscribers."""
    with node_in(domain_id, "others") as node:
        for topic in TOPICS:
            node.create_subscription(String, topic, print, 10)
        yield node


def test_everybody_is_known_in_full_when_the_wait_ends(domain_id: int, others: Node) -> None:
    with Membership(domain_id, "member") as membership:
        node = membership.node
        membership.discovery.wait(0.0, time.monotonic() + 30.0, threading.Event())
        assert not membership.was_certainly_empty
        assert [node.count_subscribers(topic) for topic in TOPICS] == [1] * len(TOPICS)
        assert "others" in node.get_node_names()


def test_who_is_alone_on_this_machine_has_nothing_to_wait_for(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Membership(domain_id, "member") as membership:
        assert membership.discovery.is_alone()
        with Membership(domain_id, "member"):
            assert not membership.discovery.is_alone()
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        assert not membership.discovery.is_alone()


def test_where_others_may_be_on_other_machines_all_the_time_is_taken(
    domain_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Membership(domain_id, "member") as membership:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        until_s = time.monotonic() + 0.5
        membership.discovery.wait(0.1, until_s, threading.Event())
        assert time.monotonic() >= until_s


def test_a_wait_that_is_stopped_ends(domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = threading.Event()
    stopped.set()
    with Membership(domain_id, "member") as membership:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
        membership.discovery.wait(0.1, time.monotonic() + 3600.0, stopped)


def test_a_process_is_complete_when_its_announced_endpoints_are_the_known_ones() -> None:
    hello, odom, scan = THEIRS + HELLO, THEIRS + READER, THEIRS + WRITER
    nobody = {OURS: introduced(OURS + WRITER), THEIRS: introduced()}
    met = [FoundEndpoint(OURS + WRITER, introduces=False), FoundEndpoint(hello, introduces=True)]
    knows_odom = [*met, FoundEndpoint(odom, introduces=False)]
    knows_both = [*knows_odom, FoundEndpoint(scan, introduces=False)]
    with_odom = nobody | {THEIRS: introduced(odom)}
    with_hello = nobody | {THEIRS: introduced(hello, odom)}
    assert count_complete(met, {OURS: nobody[OURS]}) == 1
    assert count_complete(met, nobody) == 2  # a node without endpoints
    assert count_complete(met, with_odom) == 1
    assert count_complete(knows_odom, nobody) == 1
    assert count_complete(knows_odom, with_odom) == 2
    assert count_complete(knows_odom, with_hello) == 2
    assert count_complete(knows_both, with_odom) == 1


def introduced(*gids: bytes) -> Introduction:
    return Introduction(b"", frozenset(gids), b"")


@pytest.mark.parametrize("cut", [0, 3, 19, 30, -1])
def test_an_introduction_that_is_cut_short_is_none(cut: int) -> None:
    name = struct.pack("<I4s", 4, b"/a\0\0")
    gids = struct.pack("<I", 2) + OURS + WRITER + OURS + READER
    data = b"\0\1\0\0" + OURS + b"\0\0\1\xc1" + struct.pack("<I", 1) + name * 2 + gids * 2
    assert read_introduction(data).endpoints == {OURS + WRITER, OURS + READER}
    assert read_introduction(data).process == OURS
    with pytest.raises(struct.error):
        read_introduction(data[:cut])


def test_others_know_our_publishers_when_they_have_said_so(domain_id: int, others: Node) -> None:
    with Membership(domain_id, "member") as membership:
        membership.discovery.wait(0.0, time.monotonic() + DEADLINE_S, threading.Event())
        for topic in TOPICS:
            membership.node.create_publisher(String, topic, 10)
        assert membership.discovery.make_known(time.monotonic() + DEADLINE_S, threading.Event())
        assert [others.count_publishers(topic) for topic in TOPICS] == [1] * len(TOPICS)
        assert [each.get_publisher_count() for each in others.subscriptions] == [1] * len(TOPICS)


def test_a_process_that_hangs_has_not_said_that_it_knows_our_publishers(domain_id: int) -> None:
    hanging = Hanging(domain_id)
    with closing(hanging), Membership(domain_id, "member") as membership:
        discovery, never = membership.discovery, threading.Event()
        discovery.wait(0.0, time.monotonic() + DEADLINE_S, never)
        with hanging:
            membership.node.create_publisher(String, TOPICS[0], 10)
            assert not discovery.make_known(time.monotonic() + 0.3, never)
        assert discovery.make_known(time.monotonic() + DEADLINE_S, never)


class Hanging(Told):
    """A process with a node, which hangs during a `with` block."""

    def __init__(self, domain_id: int) -> None:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
        super().__init__(peer_command("tests.support.role_peers", "MuxPeer"), environment)

    def __enter__(self) -> Self:
        self._process.send_signal(signal.SIGSTOP)
        while "T" not in Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2]:
            time.sleep(0.001)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGCONT)


OPENS = """
from robotctl.ros.context import open_context
context = open_context(0)
print(context.ok())
context.try_shutdown()
"""


@pytest.mark.parametrize("home", ["empty", "read-only", "unknown"])
def test_a_context_opens_and_writes_no_log_file(home: str, tmp_path: Path) -> None:
    homes = {"empty": {"HOME": str(tmp_path)}, "read-only": {"HOME": "/proc"}, "unknown": {}}
    elsewhere = ("HOME", "ROS_HOME", "ROS_LOG_DIR")
    environment = {name: value for name, value in os.environ.items() if name not in elsewhere}
    ran = run_python(OPENS, env=environment | homes[home])
    assert (ran.returncode, ran.stdout) == (0, "True\n"), ran.stderr
    assert not list(tmp_path.iterdir())


HANGS_AT_THE_END = """
import asyncio, ctypes, sys
from contextlib import ExitStack
from rclpy.context import Context
from robotctl.ros import context
from robotctl.ros.session import ros_session

def hang(_):
    ctypes.PyDLL(None).pause()  # as Fast DDS does: in C, with the GIL

async def main(at_end):
    domain_id = int(sys.argv[1])
    async with ros_session(domain_id=domain_id, namespace="", at_end=at_end) as session:
        session.node("hanging")
        session.last.callback(print, "kept", flush=True)

Context.destroy = hang
context.END_S = 0.1
with ExitStack() as at_end:
    asyncio.run(main(at_end))
    print("told", flush=True)
"""


def test_a_process_ends_though_the_middleware_does_not_let_go_of_it(domain_id: int) -> None:
    ran = run_python(HANGS_AT_THE_END, domain_id)
    assert (ran.returncode, ran.stdout) == (1, "kept\ntold\n")
    assert "in close_context" in ran.stderr
