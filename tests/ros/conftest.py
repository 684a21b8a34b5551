"""Fixtures for tests with real rclpy over loopback, each module in a ROS domain of its own."""

from __future__ import annotations

import asyncio
import os
import subprocess
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from threading import Event
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.node import Node

import tests.support.rosidl_parser  # noqa: F401
from robotctl.base.domains import reserved_domain
from robotctl.ros import AsyncioExecutor
from robotctl.ros.session import ros_session
from robotctl.ros.tap.subscription import TappedSubscription
from robotctl.ros.tap.tap import Tap
from tests.ros.open_executor import Bench
from tests.support import lines
from tests.support.lines import Told, peer_command
from tests.support.waiting import loop_until, until

# Inherited by every process that a test starts.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


Feed = Callable[[Any, list[int]], Awaitable[None]]
RunPython = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def domain_id() -> Iterator[int]:
    """A ROS domain that no other process uses."""
    with reserved_domain() as number:
        yield number


@pytest.fixture
def new_context(domain_id: int) -> Iterator[Callable[[], Any]]:
    """Creates initialized rclpy contexts without signal handlers.

    In about 1 of 10 processes with several contexts, one of them never discovers endpoints that
    another creates later: a race in the intra-process delivery of Fast DDS 2.14, which does not
    occur with that delivery switched off.
    """
    made: list[Context] = []

    def make() -> Context:
        made.append(Context())
        made[-1].init(args=[], domain_id=domain_id)
        return made[-1]

    yield make
    for context in made:
        context.try_shutdown()
        context.destroy()


@pytest.fixture(scope="module")
def context(domain_id: int) -> Iterator[Any]:
    """The rclpy context of the module: discovery of a new one would take seconds per test.

    Its DDS participant ends with its last node. During discovery, Fast DDS 2.14 may then deadlock
    (`DomainParticipant::set_listener` waits for its own lock), so one node stays until the other
    processes are gone.
    """
    made = Context()
    made.init(args=[], domain_id=domain_id)
    lasting = Node("lasting", context=made)
    yield made
    with suppress(AssertionError):  # A killed process stays listed for longer.
        until(lambda: len(lasting.get_node_names()) == 1)
    lasting.destroy_node()
    made.try_shutdown()
    made.destroy()


@pytest.fixture
def node(context: Any) -> Iterator[Any]:
    """A plain node without an executor."""
    made = Bench(context)
    yield made
    made.destroy_node()


@pytest.fixture
async def executor(context: Any, node: Any) -> AsyncIterator[Any]:
    """An open executor with the node; an exception in a callback fails the test."""
    raised: list[tuple[Exception, str]] = []
    async with AsyncioExecutor(
        context, on_exception=lambda error, where: raised.append((error, where))
    ) as made:
        made.add_node(node)
        yield made
    assert raised == []


@pytest.fixture
def bench(executor: Any, node: Bench) -> Bench:
    """The node, whose executor is open."""
    node.opened = executor
    return node


class Taken:
    """The topics and messages that a tap handed over."""

    def __init__(self) -> None:
        self.tap: Any = None
        self.topics: dict[str, Any] = {}
        self.messages: dict[str, list[tuple[Any, ...]]] = {}
        self.unwanted: set[str] = set()

    def open(self, topic: Any) -> Callable[..., None]:
        self.topics[topic.name] = topic
        taken = self.messages.setdefault(topic.name, [])
        return lambda *message: taken.append(message)

    def wanted(self, topic: str, type_name: str) -> bool:
        return not self.unwanted & {topic, type_name}

    def values(self, topic: str) -> list[int]:
        """The numbers of std_msgs/UInt64 messages."""
        return [int.from_bytes(message[0][4:12], "little") for message in self.messages[topic]]


@pytest.fixture
async def session(domain_id: int) -> AsyncIterator[Any]:
    """A session like the daemon's."""
    with ExitStack() as at_end:
        async with ros_session(domain_id=domain_id, namespace="", at_end=at_end) as made:
            yield made


@pytest.fixture
async def taken(session: Any) -> AsyncIterator[Taken]:
    """The topics and messages of a running tap."""
    made = Taken()
    made.tap = Tap(session, made.open, made.wanted)
    running = asyncio.create_task(made.tap.run())
    yield made
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running


class Peer:
    """A second process with plain rclpy (executor_peer.py), which executes commands."""

    def __init__(self, domain_id: int) -> None:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
        self._told = Told(peer_command("tests.ros.executor_peer"), environment)
        self.close = self._told.close

    async def __call__(self, do: str, **parameters: Any) -> Any:
        """Execute one command and return its result."""
        return await asyncio.to_thread(self._told, do, **parameters)


@pytest.fixture(scope="module")
def peer(domain_id: int) -> Iterator[Peer]:
    """The second process of a test module."""
    made = Peer(domain_id)
    yield made
    made.close()


@pytest.fixture
def feed(peer: Peer) -> Feed:
    """Lets the peer publish to a subscription after both sides have matched.

    An earlier message arrives 3 s late at best, with the next heartbeat of the middleware.
    """

    async def publish(subscription: Any, values: list[int]) -> None:
        topic = subscription.topic_name
        await peer("open", topic=topic)
        await loop_until(subscription.get_publisher_count)
        await peer("publish", topic=topic, values=values)

    return publish


@pytest.fixture
def no_subscription(monkeypatch: pytest.MonkeyPatch) -> Event:
    """While it is set, no tap can subscribe."""
    create, failing = TappedSubscription._create, Event()

    def maybe(self: TappedSubscription, sink: Any, requested: Any) -> Any:
        if failing.is_set():
            raise RuntimeError("no descriptor is free")
        return create(self, sink, requested)

    monkeypatch.setattr(TappedSubscription, "_create", maybe)
    return failing


@pytest.fixture
def topic() -> str:
    """A topic that no other test uses."""
    return f"/test_{time.monotonic_ns()}"


@pytest.fixture
def run_python(domain_id: int) -> RunPython:
    """Runs a script in a process of its own, in the module's domain."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
    return partial(lines.run_python, cwd=lines.ROOT, env=environment)
