"""rclpy's `Node` with correct types; the inside of an open AsyncioExecutor; descriptors."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.ros.executor.engine import Engine
from robotctl.ros.executor.runtime import Runtime
from tests.support.waiting import DEADLINE_S

if TYPE_CHECKING:
    import rclpy.node
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    class Node(rclpy.node.Node):
        """Its own annotations allow only callbacks of one argument that are no coroutines."""

        def create_subscription(
            self,
            msg_type: Any,
            topic: str,
            callback: Callable[..., object],
            qos_profile: QoSProfile | int,
            **options: Any,
        ) -> Subscription: ...

        def destroy_node(self) -> None: ...

else:
    from rclpy.node import Node as Node


def engine_of(executor: AsyncioExecutor) -> Engine:
    """Return the part of it that exists while it is open."""
    assert executor._engine is not None
    return executor._engine


class Heard(list[int]):
    """The numbers that an entity has delivered."""

    entity: Any
    tap: RawTap


class Bench(Node):
    """A node of an open executor, with a topic that no other test uses."""

    opened: AsyncioExecutor

    def __init__(self, context: Any) -> None:
        super().__init__("tested", context=context)
        self.topic = f"/test_{time.monotonic_ns()}"
        self._own_publishers: dict[str, Any] = {}

    @property
    def sources(self) -> dict[Any, Any]:
        """The sources of its executor."""
        return engine_of(self.opened).sources

    @property
    def runtime(self) -> Runtime:
        """The state that the sources of its executor share."""
        return engine_of(self.opened).runtime

    def listen(
        self, callback: Callable[..., object], topic: str = "", depth: int = 10, **options: Any
    ) -> Any:
        """Subscribe a callback to a topic of numbers."""
        return self.create_subscription(UInt64, topic or self.topic, callback, depth, **options)

    def hear(self, topic: str = "", depth: int = 10, **options: Any) -> Heard:
        """Subscribe to numbers."""
        heard = Heard()
        heard.entity = self.listen(lambda m: heard.append(m.data), topic, depth, **options)
        return heard

    def tap(self, topic: str = "", depth: int = 1000, **options: Any) -> Heard:
        """Tap a topic of numbers."""
        heard = Heard()

        def sink(data: bytes, *_: Any) -> None:
            heard.append(deserialize_message(data, UInt64).data)

        heard.tap = RawTap(sink, **options)
        heard.entity = self.listen(heard.tap, topic, depth, raw=True)
        return heard

    def publisher(self, topic: str = "", depth: int = 1000) -> Any:
        """Return the publisher of numbers on a topic; create it if there is none."""
        name = topic or self.topic
        if name not in self._own_publishers:
            self._own_publishers[name] = self.create_publisher(UInt64, name, depth)
        return self._own_publishers[name]

    def publish(self, *numbers: int, topic: str = "") -> None:
        """Publish numbers."""
        publisher = self.publisher(topic)
        for number in numbers:
            publisher.publish(UInt64(data=number))

    def ticks(self, period_s: float = 0.01, **options: Any) -> Heard:
        """Create a timer; return what grows by one at each of its calls."""
        ticks = Heard()
        ticks.entity = self.create_timer(period_s, lambda: ticks.append(1), **options)
        return ticks

    async def client(self, service: str = "") -> Any:
        """Return the client of a service, when the service is there."""
        client = self.create_client(SetBool, service or self.topic)
        await self.opened.wait_for_service(client, timeout_s=DEADLINE_S)
        return client


@asynccontextmanager
async def opened(node: Any, on_exception: Any = None) -> AsyncIterator[AsyncioExecutor]:
    """Open an executor with a node that has none, for a while."""
    executor = AsyncioExecutor(node.context, on_exception=on_exception)
    async with asyncio.timeout(DEADLINE_S), executor:
        executor.add_node(node)
        yield executor


def populate(node: Any, topic: str, on_message: Callable[[Any], object]) -> Any:
    """Create one entity of each kind on a node; return the publisher of the topic."""
    node.create_subscription(UInt64, topic, on_message, 100)
    node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 100, raw=True)
    node.create_service(SetBool, topic, lambda request, response: response)
    node.create_client(SetBool, topic)
    node.create_timer(0.001, lambda: None)
    node.create_guard_condition(lambda: None)
    return node.create_publisher(UInt64, topic, 100)


def loop_descriptors() -> int:
    """Count the open descriptors of the kinds that an executor or a ticker waits on."""
    count = 0
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # it was closed after it was listed
            count += os.readlink(descriptor).startswith("anon_inode:")
    return count


async def turns_while_waiting() -> int:
    """Count the turns of the loop in 0.1 s; a loop that spins has thousands."""
    selector: Any = asyncio.get_running_loop()._selector  # type: ignore[attr-defined]
    select = selector.select
    turns = 0

    def counted(timeout: float | None = None) -> object:
        nonlocal turns
        turns += 1
        return select(timeout)

    selector.select = counted
    try:
        await asyncio.sleep(0.1)
    finally:
        del selector.select
    return turns


async def comes_to_rest() -> bool:
    """Return whether the loop comes to rest after pending work is done."""
    for _ in range(20):
        if await turns_while_waiting() < 20:
            return True
    return False
