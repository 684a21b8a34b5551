# mypy: disallow-untyped-calls=False
"""Runs the one node of an executable in the asyncio loop."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final, TypeVar

from rclpy.context import Context
from rclpy.node import Node

from robotctl.base.domains import requested_domain
from robotctl.base.errors import UsageError
from robotctl.base.own_process import end_signals
from robotctl.config.ros_settings import check_parameter_files
from robotctl.ros.context import BAD_ARGUMENTS, close_context
from robotctl.ros.executor import AsyncioExecutor, run

LOGGER_SERVICES: Final = {"enable_logger_service": True}
"""The option of rclpy's Node for services that get and set its loggers' levels."""

Made = TypeVar("Made", bound=Node)


@asynccontextmanager
async def opened_node(
    make_node: Callable[[Context], Made], at_end: Callable[[Made], None] = lambda node: None
) -> AsyncIterator[tuple[Made, AsyncioExecutor]]:
    """Make a node, and run its callbacks in the loop until the block ends.

    rclpy reads `--ros-args` of the command line. Unless the block raises, `at_end(node)` is called
    before the node is destroyed.

    Raises:
        UsageError: An argument is wrong, or ROS_DOMAIN_ID is not a domain.
        ConfigError: A parameter file cannot be read, or has parameters for other nodes only.
    """
    context = Context()
    nodes: list[Node] = []
    try:
        try:
            context.init(args=sys.argv, domain_id=requested_domain(None))
            node = make_node(context)
        except BAD_ARGUMENTS as error:
            raise UsageError(str(error).partition("\n")[0]) from error
        nodes.append(node)
        check_parameter_files(sys.argv, node.get_fully_qualified_name())
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            yield node, executor
        at_end(node)
    finally:
        close_context(context, nodes)


def run_node(
    make_node: Callable[[Context], Made], at_end: Callable[[Made], None] = lambda node: None
) -> int:
    """Run a node until SIGINT, SIGTERM or SIGHUP, then call `at_end(node)` and return 0."""
    return run(_run(make_node, at_end))


async def _run(make_node: Callable[[Context], Made], at_end: Callable[[Made], None]) -> int:
    ended = end_signals()
    async with opened_node(make_node, at_end) as (node, _):
        await ended.wait()
        node.get_logger().info("Shutting down ...")
    return 0
