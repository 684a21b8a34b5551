"""Executors and entities that come and go leave no files, threads or memory behind."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Awaitable, Callable
from subprocess import CompletedProcess
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import UInt64

from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.open_executor import loop_descriptors, populate
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]
RunPython = Callable[..., CompletedProcess[str]]


async def test_200_starts_and_stops_under_traffic_leave_nothing_behind(
    context: Any, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    publisher = populate(node, topic, lambda message: got.append(message.data))
    stop = threading.Event()

    def publish() -> None:
        while not stop.is_set():
            publisher.publish(UInt64())
            time.sleep(0.0002)

    async def cycle() -> None:
        count = len(got)
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            await until(lambda: len(got) > count)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        await cycle()
        gc.collect()
        before = (loop_descriptors(), threading.active_count())
        for _ in range(200):
            await cycle()
        gc.collect()
        assert (loop_descriptors(), threading.active_count()) == before
    finally:
        stop.set()
        thread.join()


CYCLES = """
import asyncio, gc, os, resource, sys, threading
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool
from robotctl.ros import AsyncioExecutor, RawTap, Ticker

cycles = int(sys.argv[1])

async def cycle():
    context = Context()
    context.init(args=[])
    got = asyncio.Event()
    async with AsyncioExecutor(context) as executor:
        node = Node("tested", context=context)
        executor.add_node(node)
        node.create_subscription(UInt64, "flood", lambda _: got.set(), 100)
        node.create_subscription(UInt64, "flood", RawTap(lambda *_: got.set()), 100, raw=True)
        node.create_service(SetBool, "served", lambda request, response: response)
        client = node.create_client(SetBool, "served")
        node.create_guard_condition(lambda: None).trigger()
        publisher = node.create_publisher(UInt64, "flood", 100)
        node.create_timer(0.0005, lambda: publisher.publish(UInt64()))
        async with asyncio.timeout(30):
            await got.wait()
            async for _ in Ticker(1000.0):
                break
            await executor.call(client, SetBool.Request(), timeout_s=30)
        executor.create_task(executor.call, client, SetBool.Request(), timeout_s=30)
    node.destroy_node()
    context.shutdown()
    context.destroy()

def state():
    gc.collect()
    with open("/proc/self/statm") as statm:
        resident = int(statm.read().split()[1]) * resource.getpagesize()
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task")), resident

async def main():
    for _ in range(20):
        await cycle()
    before = state()
    for _ in range(cycles):
        await cycle()
    after = state()
    print(*before, *after)

asyncio.run(main())
"""


def test_200_lives_of_a_whole_context_leave_files_threads_and_memory_as_they_were(
    run_python: RunPython,
) -> None:
    ended = run_python(CYCLES, 200, timeout_s=600)
    assert ended.returncode == 0, ended.stderr
    files, threads, memory, files_after, threads_after, memory_after = map(
        int, ended.stdout.split()
    )
    assert (files_after, threads_after) == (files, threads)
    # rclpy's own contexts leak a little; 200 of them must not leak 50 kB each.
    assert memory_after - memory < 10_000_000


async def test_churn_of_subscriptions_under_traffic_loses_no_message_of_the_others(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10_000)
    publisher = node.create_publisher(UInt64, topic, 10_000)
    sent = 0

    def publish() -> None:
        nonlocal sent
        publisher.publish(UInt64(data=sent))
        sent += 1

    node.create_timer(0.0005, publish, callback_group=ReentrantCallbackGroup())
    await until(lambda: got)
    before = loop_descriptors()
    for _ in range(60):
        batch = [
            node.create_subscription(UInt64, topic, lambda _: None, 10),
            node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 10, raw=True),
        ]
        seen = len(got)

        def has_more(seen: int = seen) -> bool:
            return len(got) > seen

        await until(has_more)
        for subscription in batch:
            node.destroy_subscription(subscription)
    await until(lambda: loop_descriptors() == before)
    count = sent
    await until(lambda: len(got) >= count)
    assert got == list(range(len(got)))
