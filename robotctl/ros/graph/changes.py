"""Waits for changes of the ROS graph, at which rcl triggers a guard condition of the node."""

from __future__ import annotations

import asyncio
import ctypes
import threading
from contextlib import suppress
from typing import Any, Self

from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node


class GraphChanges:
    """Watches for changes of the graph during the `with` block, for one task of the loop.

    rcl has no callback for graph changes, so a thread waits for them. After a change the thread
    pauses until the task calls `wait` again; so even constant changes cost little.
    """

    def __init__(self, node: Node) -> None:
        """Watch the graph that `node` sees."""
        self._node = node
        self._changed = asyncio.Event()
        self._awaited = threading.Event()
        self._ended = False

    def __enter__(self) -> Self:
        """Begin to watch.

        Raises:
            RuntimeError: No thread can be started.
        """
        self._loop = asyncio.get_running_loop()
        self._end = GuardCondition(None, None, context=self._node.context)
        self._thread = threading.Thread(target=self._run, name="graph changes", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            self._end.destroy()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._end.trigger()
        self._awaited.set()
        self._thread.join()
        self._end.destroy()

    async def wait(self, at_most_s: float) -> bool:
        """Wait at most `at_most_s` seconds for a change; return whether there was one.

        A change since the last `wait` ends the wait at once. One change may be reported twice.
        """
        self._awaited.set()
        with suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await self._changed.wait()
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    # In the thread

    def _run(self) -> None:
        context, node = self._node.context.handle, self._node.handle
        assert context is not None
        with context, node:
            wait_set = _rclpy.WaitSet(0, 2, 0, 0, 0, 0, context)
            while not self._ended:
                wait_set.clear_entities()
                wait_set.add_guard_condition(self._end.handle)
                _add_graph_of(node.pointer, wait_set.pointer)
                wait_set.wait(-1)
                with suppress(RuntimeError):  # the loop is closed: no task waits
                    self._loop.call_soon_threadsafe(self._changed.set)
                self._awaited.wait()
                self._awaited.clear()


def _add_graph_of(node: int, wait_set: int) -> None:
    """Add the graph guard condition of the rcl_node_t at `node` to the rcl_wait_set_t."""
    library: Any = ctypes.PyDLL("librcl.so")
    library.rcl_node_get_graph_guard_condition.restype = ctypes.c_void_p
    guard = library.rcl_node_get_graph_guard_condition(ctypes.c_void_p(node))
    library.rcl_wait_set_add_guard_condition(
        ctypes.c_void_p(wait_set), ctypes.c_void_p(guard), None
    )
