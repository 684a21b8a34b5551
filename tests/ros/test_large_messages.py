"""A large message is passed to the recorder as a view, and its buffer is freed."""

from __future__ import annotations

from array import array
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from robotctl.ros.executor import RawTap, raw_tap
from robotctl.ros.executor.raw_tap import SerializedTaker

Until = Callable[[Callable[[], object]], Awaitable[None]]
LARGE = raw_tap.LARGE_BYTES + 1


def large(value: int) -> Any:
    from std_msgs.msg import UInt8MultiArray

    return UInt8MultiArray(data=array("B", bytes([value]) * LARGE))


@pytest.mark.parametrize("views", [True, False])
async def test_a_large_message_is_whole_and_only_lent_where_that_is_asked_for(
    executor: Any, node: Any, topic: str, until: Until, views: bool
) -> None:
    from std_msgs.msg import UInt8MultiArray

    taken: list[bytes | memoryview] = []
    copies: list[bytes] = []

    def sink(data: Any, *_: Any) -> None:
        taken.append(data)
        copies.append(bytes(data))

    node.create_subscription(UInt8MultiArray, topic, RawTap(sink, views=views), 10, raw=True)
    publisher = node.create_publisher(UInt8MultiArray, topic, 10)
    await until(publisher.get_subscription_count)
    for value in (1, 2):
        publisher.publish(large(value))
    await until(lambda: len(taken) == 2)
    assert [copy[-LARGE:] == bytes([value]) * LARGE for value, copy in enumerate(copies, 1)] == [
        True,
        True,
    ]
    if views:
        with pytest.raises(ValueError, match="released"):
            len(taken[0])
    else:
        assert taken == copies


async def test_a_buffer_that_does_not_fit_the_budget_is_given_back_at_once(
    executor: Any, node: Any, topic: str, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_msgs.msg import UInt8MultiArray

    monkeypatch.setattr(raw_tap, "KEPT_BYTES", SerializedTaker._kept_by_all + LARGE * 2)
    topics = [f"{topic}_{number}" for number in range(4)]
    heard: list[int] = []
    taps = [RawTap(lambda data, *_: heard.append(len(data))) for _ in topics]
    kept_before = SerializedTaker._kept_by_all
    subscriptions = [
        node.create_subscription(UInt8MultiArray, name, tap, 10, raw=True)
        for name, tap in zip(topics, taps, strict=True)
    ]
    publishers = [node.create_publisher(UInt8MultiArray, name, 10) for name in topics]
    await until(lambda: all(each.get_subscription_count() for each in publishers))
    for publisher in publishers:
        publisher.publish(large(0))
    await until(lambda: len(heard) == len(topics))
    await until(lambda: SerializedTaker._kept_by_all > kept_before)  # at the take after a message
    assert SerializedTaker._kept_by_all <= raw_tap.KEPT_BYTES
    for subscription in subscriptions:
        node.destroy_subscription(subscription)
    await until(lambda: SerializedTaker._kept_by_all == kept_before)
