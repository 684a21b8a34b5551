# mypy: disallow-untyped-calls=False
"""AsyncioExecutor: rclpy's callbacks in the asyncio loop, without a spinning thread.

    async with AsyncioExecutor() as executor:
        executor.add_node(node)
        await executor.serve()

Callbacks run in the loop's thread, may be `async def` and may await anything of asyncio. Callback
groups do not hold back responses: a callback may await a client of its own group.
"""

from __future__ import annotations

import asyncio
import threading
from typing import Any, NoReturn, Self

from rclpy.action.client import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import get_default_context

from robotctl.ros.executor import futures
from robotctl.ros.executor.announcements import check_announcements
from robotctl.ros.executor.engine import Engine, Nodes
from robotctl.ros.executor.futures import Tasks
from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.runtime import ExceptionHandler

SERVICE_POLL_S = 0.02


class AsyncioExecutor:
    """Runs the callbacks of rclpy nodes in an asyncio loop while `async with` is open.

    Any thread may call `add_node`, `remove_node`, `get_nodes`, `create_task`, `wake` and
    `shutdown`. An exception in a callback goes to `on_exception(error, where)`, by default to the
    loop's exception handler.
    """

    def __init__(
        self,
        context: Context | None = None,
        *,
        on_exception: ExceptionHandler | None = None,
        fifo_priority: int | None = None,
    ) -> None:
        """Serve nodes of `context` (default: rclpy's default context).

        `fifo_priority` requests SCHED_FIFO for the loop's thread. `scheduling` is the result.

        Raises:
            ValueError: The priority is outside 1..99.
        """
        if fifo_priority is not None and not 1 <= fifo_priority <= 99:
            raise ValueError(f"a SCHED_FIFO priority must be 1 to 99, not {fifo_priority}")
        self._context = get_default_context() if context is None else context
        self._on_exception = on_exception
        self._fifo_priority = fifo_priority
        self._loop_thread = LoopThread()
        self._nodes = Nodes(self)
        self._tasks = Tasks(self, self._loop_thread)
        self._engine: Engine | None = None
        """None until the executor is open."""

        self._opened = False
        self._is_shutdown = False
        """Whether no new callback may begin. rclpy's executors have the same attribute."""

        self._closed = False
        """Whether all nodes and entities were released."""

        self._served = asyncio.Event()
        self._finished = threading.Event()

    # Opening and closing

    async def __aenter__(self) -> Self:
        """Begin to run callbacks in the running loop. A failure closes the executor.

        Raises:
            UnsupportedPlatform: Eventfds do not work here.
            RuntimeError: The executor is open or was shut down, or its context is not initialized.
        """
        self._refuse_closed()
        if self._opened:
            raise RuntimeError("this executor is open already; an executor serves one loop, once")
        if not self._context.ok():
            raise RuntimeError("the executor's context is not initialized; call rclpy.init() first")
        self._opened = True
        try:
            await check_announcements(self._context)
            self._refuse_closed()
            loop = asyncio.get_running_loop()
            self._engine = Engine(
                self, loop, self._loop_thread, self._nodes, self._close, self._on_exception
            )
            self._tasks.runtime = self._engine.runtime
            self._loop_thread.open(loop)
            self._engine.open(self._fifo_priority)
        except BaseException:
            self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self._close()
        assert self._engine is not None
        await asyncio.gather(*self._engine.runtime.tasks, return_exceptions=True)

    async def serve(self) -> None:
        """Wait until the executor or its context is shut down. Callbacks also run without this.

        Raises:
            RuntimeError: The executor is not open, or runs in another loop.
        """
        if not self._is_shutdown:
            self._running()
        await self._served.wait()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Begin no more callbacks, release all nodes and cancel running tasks.

        Any thread, callback or signal handler may call this. Outside the loop's thread, it waits
        for running callbacks, at most `timeout_sec` seconds (None or negative: no limit).

        Returns:
            Whether no callback runs any more.
        """
        engine = self._engine
        if engine is None or not engine.runtime.loop.is_running():
            self._close()
            return engine is None or not engine.runtime.tasks
        self._is_shutdown = True
        self._tasks.closed = True
        engine.request_close()
        if self._loop_thread.is_current():
            return not engine.runtime.tasks
        return self._finished.wait(None if timeout_sec is None or timeout_sec < 0 else timeout_sec)

    @property
    def context(self) -> Context:
        """The rclpy context of the nodes."""
        return self._context

    @property
    def scheduling(self) -> str:
        """The scheduling policy of the loop's thread, as text."""
        return "SCHED_OTHER" if self._engine is None else self._engine.scheduling

    # The interface of rclpy.executors.Executor

    def add_node(self, node: Node) -> bool:
        """Run the node's callbacks.

        Returns:
            False if the node was added before, as in rclpy.

        Raises:
            RuntimeError: The executor was shut down, or another live executor has the node.
        """
        self._refuse_closed()
        if not self._nodes.add(node):
            return False
        self.wake()
        return True

    def remove_node(self, node: Node) -> None:
        """Stop running the node's callbacks. A node that was not added is ignored."""
        if not self._nodes.remove(node):
            return
        if self._engine is not None and self._loop_thread.is_current():
            self._engine.sync()
        else:
            self.wake()

    def get_nodes(self) -> list[Node]:
        """Return the nodes whose callbacks this executor runs."""
        return list(self._nodes)

    def create_task(self, callback: Any, *args: Any, **kwargs: Any) -> Future:
        """Run a function, a coroutine function or a coroutine in the loop, and return its future.

        An exception goes into the future, and to the exception handler if the future has no done
        callback.

        Raises:
            RuntimeError: The executor was shut down.
        """
        self._refuse_closed()
        return self._tasks.create(callback, args, kwargs)

    def wake(self) -> None:
        """Look for new and destroyed entities. rclpy calls this when a node changes."""
        if self._engine is not None:
            self._engine.wake()

    def spin(self, *_: object, **__: object) -> NoReturn:
        """Refuse: an AsyncioExecutor does not spin.

        Raises:
            RuntimeError: Always.
        """
        raise RuntimeError("an AsyncioExecutor does not spin; use: await executor.serve()")

    spin_once = spin
    spin_until_future_complete = spin
    spin_once_until_future_complete = spin

    # Calls to await

    async def call(self, client: Client, request: Any, *, timeout_s: float | None) -> Any:
        """Call a service and return its response. Without a server, the request is lost.

        Raises:
            TimeoutError: No response came within `timeout_s` seconds (None: no deadline).
            ShutdownException: The client was destroyed or the executor shut down meanwhile.
            RuntimeError: The client's node, or the running loop, is not of this executor.
        """
        engine = self._running()
        if engine.runtime.stale:
            engine.sync()
        if client not in engine.sources:
            raise RuntimeError(
                f"the client of {client.srv_name} belongs to no node of this executor, "
                "so its response would not be taken; call add_node first"
            )
        try:
            async with asyncio.timeout(timeout_s) as deadline:
                return await futures.wait(client.call_async(request))
        except TimeoutError:
            if not deadline.expired():
                raise
            raise TimeoutError(
                f"no response from service {client.srv_name} within {timeout_s:g} s; "
                "is its node running?"
            ) from None

    async def wait_for(self, future: Future, *, timeout_s: float | None) -> Any:
        """Return the result of an rclpy Future, and cancel the future if no result comes.

        Raises:
            TimeoutError: No result came within `timeout_s` seconds (None: no deadline).
            RuntimeError: This is not the executor's loop.
        """
        self._running()
        async with asyncio.timeout(timeout_s):
            return await futures.wait(future)

    async def wait_for_service(
        self, client: Client | ActionClient, *, timeout_s: float | None
    ) -> None:
        """Wait until a server for the client is discovered.

        Raises:
            TimeoutError: No server was discovered within `timeout_s` seconds (None: no deadline).
            RuntimeError: This is not the executor's loop.
        """
        self._running()
        if isinstance(client, ActionClient):
            ready, name = client.server_is_ready, client._action_name
        else:
            ready, name = client.service_is_ready, client.srv_name
        try:
            async with asyncio.timeout(timeout_s):
                while not ready():  # noqa: ASYNC110 - the graph has no callback
                    await asyncio.sleep(SERVICE_POLL_S)
        except TimeoutError:
            raise TimeoutError(
                f"no server for {name} within {timeout_s:g} s; is its node running?"
            ) from None

    # Internals

    def _refuse_closed(self) -> None:
        if self._is_shutdown:
            raise RuntimeError("this executor was shut down; create a new one")

    def _running(self) -> Engine:
        self._refuse_closed()
        if self._engine is None:
            raise RuntimeError("this executor is not open; use: async with executor")
        if asyncio.get_running_loop() is not self._engine.runtime.loop:
            raise RuntimeError("this executor runs in another event loop; give each loop its own")
        return self._engine

    def _close(self) -> None:
        self._is_shutdown = True
        if self._closed:
            return
        self._closed = True
        self._tasks.closed = True
        self._served.set()
        for node in self._nodes:
            self._nodes.remove(node)
        if self._engine is None:
            self._loop_thread.give_up()
            self._finished.set()
        else:
            self._engine.close(self._finished.set)
