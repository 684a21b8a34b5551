"""A callback that holds the loop is named, with its duration."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.open_executor import runtime_of
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]


def named_ms(caplog: pytest.LogCaptureFixture, whom: str) -> list[int]:
    """Return the durations in the warnings about one callback; a busy machine may cause others."""
    found = (re.search(r"(.*) held the loop for (\d+) ms", text) for text in caplog.messages)
    return [int(each[2]) for each in found if each is not None and whom in each[1]]


@pytest.mark.parametrize("kind", ["subscription", "tap", "service", "timer", "guard", "task"])
async def test_a_callback_that_holds_the_loop_is_named_with_its_duration(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    caplog: pytest.LogCaptureFixture,
    kind: str,
) -> None:
    def hog(*arguments: Any) -> Any:
        time.sleep(0.06)
        return arguments[-1] if arguments else None

    match kind:
        case "subscription":
            node.create_subscription(UInt64, topic, hog, 10)
        case "tap":
            node.create_subscription(UInt64, topic, RawTap(hog), 10, raw=True)
        case "service":
            node.create_service(SetBool, topic, hog)
            node.create_client(SetBool, topic).call_async(SetBool.Request())
        case "timer":
            node.create_timer(0.1, hog)
        case "guard":
            node.create_guard_condition(hog).trigger()
        case "task":
            executor.create_task(hog)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, kind)))
    assert ("hog" in caplog.text) or kind == "tap"


async def test_a_callback_that_blocks_again_and_again_is_not_named_every_time(
    executor: AsyncioExecutor,
    node: Node,
    until: Until,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    called: list[int] = []

    def hog() -> None:
        called.append(1)
        time.sleep(0.06)

    node.create_timer(0.001, hog)
    await until(lambda: len(called) >= 3)
    assert len(named_ms(caplog, "hog")) == 1
    monkeypatch.setattr(runtime_of(executor).slow, "_quiet_until_ns", {})
    await until(lambda: len(named_ms(caplog, "hog")) == 2)
    assert "times since the last warning" in caplog.text


async def test_an_async_callback_that_blocks_between_two_awaits_is_named(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    caplog: pytest.LogCaptureFixture,
) -> None:
    took_ms: list[float] = []

    async def hog(message: UInt64) -> None:
        begun = time.monotonic()
        await asyncio.sleep(0.2)
        time.sleep(0.06)  # noqa: ASYNC251 - it is to block
        took_ms.append((time.monotonic() - begun) * 1e3)
        await asyncio.sleep(0)

    node.create_subscription(UInt64, topic, hog, 10)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, "hog")))
    assert max(named_ms(caplog, "hog")) < took_ms[0]  # the time of its wait does not count
