"""A tap for viewers says why a topic cannot be subscribed to, until it can."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from threading import Event
from typing import Any

from robotctl.ros.tap.on_demand import OnDemandTap

Until = Callable[[Callable[[], object]], Awaitable[None]]


class Watcher:
    """What a tap has told."""

    def __init__(self) -> None:
        self.topics: set[str] = set()
        self.problems: dict[str, str] = {}

    def appeared(self, topic: str, *_: str) -> None:
        self.topics.add(topic)

    def vanished(self, topic: str) -> None:
        self.topics.discard(topic)

    def unusable(self, topic: str, problem: str) -> None:
        self.problems[topic] = problem


async def test_a_problem_is_taken_back_once_the_topic_can_be_subscribed_to(
    session: Any, node: Any, topic: str, until: Until, no_subscription: Event
) -> None:
    from std_msgs.msg import UInt64

    no_subscription.set()
    published, watcher = node.create_publisher(UInt64, topic, 10), Watcher()
    tap = OnDemandTap(session.node("_view"), watcher)
    watching = asyncio.create_task(tap.run())
    try:
        await until(lambda: topic in watcher.topics)
        heard: list[bytes] = []
        tap.want(topic, lambda data, *_: heard.append(bytes(data)))
        assert (
            "cannot be subscribed to (RuntimeError: no descriptor is free)"
            in watcher.problems[topic]
        )
        no_subscription.clear()
        await until(published.get_subscription_count)
        assert watcher.problems[topic] == ""
        published.publish(UInt64(data=5))
        await until(lambda: heard)
    finally:
        watching.cancel()
        await asyncio.wait({watching})
        tap.unwant(topic)
