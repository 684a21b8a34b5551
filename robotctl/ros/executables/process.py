# mypy: disallow-untyped-calls=False
"""Runs one node until Ctrl-C, in the asyncio loop."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import Callable
from typing import TypeVar

from rclpy.context import Context
from rclpy.node import Node

from robotctl.ros.context import close_context
from robotctl.ros.executor import AsyncioExecutor

Made = TypeVar("Made", bound=Node)


def run_node(make_node: Callable[[Context], Made], at_end: Callable[[Made], None]) -> int:
    """Run the node that `make_node` returns until SIGINT, SIGTERM or SIGHUP; return 0.

    The command line goes to rclpy, so `--ros-args` can rename, remap and set parameters. `at_end`
    is called with the node before it leaves the graph, when no callback runs any more.
    """
    return asyncio.run(_run(make_node, at_end))


async def _run(make_node: Callable[[Context], Made], at_end: Callable[[Made], None]) -> int:
    loop, stopped = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, stopped.set)
    context = Context()
    context.init(args=sys.argv)
    node = make_node(context)
    try:
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            await stopped.wait()
            node.get_logger().info("Shutting down ...")
        at_end(node)
    finally:
        close_context(context, [node])
    return 0
