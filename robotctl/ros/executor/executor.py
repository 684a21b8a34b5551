# mypy: disallow-untyped-calls=False
"""AsyncioExecutor: rclpy's callbacks in the asyncio loop, without a spinning thread.

Where an rclpy executor builds a wait set for every message, this one lets rcl write to an eventfd
that asyncio watches (see `rcl`). Nodes, entities and callbacks stay plain rclpy:

    async with AsyncioExecutor() as executor:
        executor.add_node(node)
        await executor.serve()

Callbacks run in the loop's thread, may be `async def` and may await anything of asyncio, and
`await client.call_async(request)` works in them as in any other task of the loop. Callback groups
mean what they mean in rclpy, with one difference: responses are not held back by them, so a
callback may await a call whose client is in the callback's own group.
"""

from __future__ import annotations

import asyncio
import threading
from contextlib import suppress
from typing import Any, NoReturn, Self

from rclpy.action.client import ActionClient
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options
from rclpy.task import Future
from rclpy.utilities import get_default_context

from robotctl.ros.executor import futures
from robotctl.ros.executor.entities import Attachments
from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.nodes import Nodes
from robotctl.ros.executor.realtime import FifoScheduling, check_priority
from robotctl.ros.executor.runtime import ExceptionHandler, Runtime, log
from robotctl.ros.executor.self_test import prove
from robotctl.ros.executor.sources.waitset import WaitSetThread
from robotctl.ros.executor.tasks import Tasks

SERVICE_POLL_S = 0.02


class AsyncioExecutor:
    """Runs the callbacks of rclpy nodes in an asyncio loop, for as long as `async with` is open.

    It behaves as an `rclpy.executors.Executor`: `add_node`, `remove_node`, `get_nodes`,
    `create_task`, `wake`, `shutdown`, all of them callable from any thread. Nothing spins: the
    loop itself is what runs.

    An exception in a callback goes to `on_exception(error, where)`, by default to the loop's own
    exception handler; the executor goes on.
    """

    def __init__(
        self,
        context: Context | None = None,
        *,
        on_exception: ExceptionHandler | None = None,
        fifo_priority: int | None = None,
    ) -> None:
        """Serve nodes of `context` (default: rclpy's default context).

        fifo_priority asks for SCHED_FIFO (1..99) for the loop's thread while the executor is
        open; `scheduling` says what came of it.

        Raises:
            ValueError: the priority is outside 1..99.
        """
        if fifo_priority is not None:
            check_priority(fifo_priority)
        self._context = get_default_context() if context is None else context
        self._on_exception = on_exception
        self._fifo_priority = fifo_priority
        self._fifo: FifoScheduling | None = None
        self._loop_thread = LoopThread()
        self._nodes = Nodes(self)
        self._tasks = Tasks(self, self._loop_thread)
        self._runtime: Runtime | None = None
        self._wait_set: WaitSetThread | None = None
        self._attachments: Attachments | None = None
        self._sync_scheduled = False
        self._opened = False
        self._is_shutdown = False
        """Asked to end: no callback begins any more. rclpy's executors call it the same."""
        self._closed = False
        """Everything has been let go of."""
        self._served = asyncio.Event()
        self._finished = threading.Event()

    # The life of an executor.

    async def __aenter__(self) -> Self:
        """Begin to run callbacks in the running loop.

        Where that fails the executor is closed, and its nodes are free for another one.

        Raises:
            UnsupportedPlatform: eventfds do not work here.
            RuntimeError: the executor is open, was closed or is shut down while it opens, or its
                context is not initialized.
        """
        self._refuse_closed()
        if self._opened:
            raise RuntimeError("this executor is open already; an executor serves one loop, once")
        if not self._context.ok():
            raise RuntimeError("the executor's context is not initialized; call rclpy.init() first")
        self._opened = True
        try:
            await prove(self._context)
            self._refuse_closed()
            self._open(asyncio.get_running_loop())
        except BaseException:
            self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self._close()
        assert self._runtime is not None
        await asyncio.gather(*self._runtime.tasks, return_exceptions=True)

    async def serve(self) -> None:
        """Wait until the executor or its context is shut down.

        Callbacks run from the beginning of `async with`, with this or without it.

        Raises:
            RuntimeError: the executor is not open, or runs in another loop.
        """
        if not self._is_shutdown:
            self._running()
        await self._served.wait()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Run no more callbacks, let go of all nodes and cancel what still runs.

        From any thread, a callback or a signal handler. Another thread waits for the callbacks
        that are still running, `timeout_sec` seconds at most (None or negative: for ever); in the
        loop's own thread nothing is waited for: leaving `async with` does that.

        Returns:
            Whether nothing runs any more.
        """
        runtime = self._runtime
        if runtime is None or not runtime.loop.is_running():
            self._close()
            return runtime is None or not runtime.tasks
        self._is_shutdown = True
        self._tasks.close()
        runtime.stale = True
        # Not at once: a signal handler may run in the midst of what would be torn down.
        runtime.loop.call_soon_threadsafe(self._close)
        if self._loop_thread.is_current():
            return not runtime.tasks
        return self._finished.wait(None if timeout_sec is None or timeout_sec < 0 else timeout_sec)

    @property
    def context(self) -> Context:
        """The context of its nodes."""
        return self._context

    @property
    def scheduling(self) -> str:
        """How the kernel schedules the loop's thread, in words for `status`."""
        return "SCHED_OTHER" if self._fifo is None else self._fifo.description

    # What an rclpy.executors.Executor offers.

    def add_node(self, node: Node) -> bool:
        """Run the node's callbacks.

        Returns:
            False where the node is here already, as rclpy does.

        Raises:
            RuntimeError: the executor was shut down, or another live executor has the node.
        """
        self._refuse_closed()
        if not self._nodes.add(node):
            return False
        self.wake()
        return True

    def remove_node(self, node: Node) -> None:
        """Run the node's callbacks no more; a node that is not here is ignored."""
        if not self._nodes.remove(node):
            return
        if self._loop_thread.is_current():
            self._sync()
        else:
            self.wake()

    def get_nodes(self) -> list[Node]:
        """The nodes whose callbacks run here."""
        return list(self._nodes)

    def create_task(self, callback: Any, *args: Any, **kwargs: Any) -> Future:
        """Run a function, a coroutine function or a coroutine in the loop, soon.

        An exception that no done callback of the returned future takes up goes to the exception
        handler as well.

        Raises:
            RuntimeError: the executor was shut down.
        """
        self._refuse_closed()
        return self._tasks.create(callback, args, kwargs)

    def wake(self) -> None:
        """Look at the nodes again: an entity was created or destroyed. rclpy calls this."""
        runtime = self._runtime
        if runtime is None or self._is_shutdown:
            return
        runtime.stale = True
        if not self._loop_thread.is_current():
            with suppress(RuntimeError):  # The loop is closed: nothing is left to look at.
                runtime.loop.call_soon_threadsafe(self._sync_if_stale)
        elif not self._sync_scheduled:
            self._sync_scheduled = True
            runtime.loop.call_soon(self._sync_if_stale)

    def spin(self, *_: object, **__: object) -> NoReturn:
        """Not here: an AsyncioExecutor lives in a running loop.

        Raises:
            RuntimeError: always.
        """
        raise RuntimeError("an AsyncioExecutor does not spin; use: await executor.serve()")

    spin_once = spin
    spin_until_future_complete = spin
    spin_once_until_future_complete = spin

    # What asyncio asks for.

    async def call(self, client: Client, request: Any, *, timeout_s: float | None) -> Any:
        """Call a service and return its response.

        A request to a service that is not there is lost: see `wait_for_service`.

        Raises:
            TimeoutError: no response within `timeout_s` seconds (None: wait for ever).
            ShutdownException: the client was destroyed or the executor shut down meanwhile.
            RuntimeError: the client's node is not in this executor, or this is another loop.
        """
        runtime = self._running()
        if runtime.stale:
            self._sync()
        if self._attachments is None or client not in self._attachments:
            raise RuntimeError(
                f"the client of {client.srv_name} belongs to no node of this executor: "
                "nobody would take the response; call add_node first"
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
        """The result of any rclpy Future; the deadline or a cancellation cancels it.

        Raises:
            TimeoutError: no result within `timeout_s` seconds (None: wait for ever).
            RuntimeError: this is not the executor's loop.
        """
        self._running()
        async with asyncio.timeout(timeout_s):
            return await futures.wait(future)

    async def wait_for_service(
        self, client: Client | ActionClient, *, timeout_s: float | None
    ) -> None:
        """Wait until a server for the client is there.

        Raises:
            TimeoutError: none came within `timeout_s` seconds (None: wait for ever).
            RuntimeError: this is not the executor's loop.
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
            raise TimeoutError(f"nobody serves {name} within {timeout_s:g} s") from None

    # Inside.

    def _refuse_closed(self) -> None:
        if self._is_shutdown:
            raise RuntimeError("this executor was shut down; create a new one")

    def _running(self) -> Runtime:
        self._refuse_closed()
        if self._runtime is None:
            raise RuntimeError("this executor is not open; use: async with executor")
        if asyncio.get_running_loop() is not self._runtime.loop:
            raise RuntimeError("this executor runs in another event loop; give each loop its own")
        return self._runtime

    def _open(self, loop: asyncio.AbstractEventLoop) -> None:
        runtime = Runtime(loop, self._sync, self._on_exception)
        self._wait_set = WaitSetThread(runtime, self._context, self._close)
        self._attachments = Attachments(runtime, self._wait_set, self)
        self._runtime = runtime
        futures.open_bridge(loop)
        if self._fifo_priority is not None:
            self._fifo = FifoScheduling(self._fifo_priority)
            log.info("the loop's thread runs under %s", self._fifo.description)
        self._tasks.open(runtime)
        self._loop_thread.open(loop)
        self._context.on_shutdown(self._on_context_shutdown)
        if get_current_signal_handlers_options() != SignalHandlerOptions.NO:
            self._wait_set.watch_signals()
        self._sync()

    def _sync_if_stale(self) -> None:
        self._sync_scheduled = False
        if self._runtime is not None and self._runtime.stale:
            self._sync()

    def _sync(self) -> None:
        """Attach what is new on the nodes, detach what is gone."""
        if self._runtime is None or self._attachments is None:
            return
        if self._is_shutdown:
            self._close()
            return
        self._runtime.stale = False
        self._attachments.follow(self._nodes.entities())

    def _on_context_shutdown(self) -> None:
        # In any thread, with the context's lock held: only ask the loop.
        if not self._is_shutdown:
            with suppress(RuntimeError):  # The loop is closed: nothing is left to let go of.
                self._loop_thread.call_soon(self._close)

    def _close(self) -> None:
        self._is_shutdown = True
        if self._closed:
            return
        self._closed = True
        self._tasks.close()
        self._served.set()
        self._nodes.clear()
        if self._runtime is None:
            self._loop_thread.give_up()
            self._finished.set()
        else:
            self._tear_down(self._runtime)

    def _tear_down(self, runtime: Runtime) -> None:
        assert self._attachments is not None
        assert self._wait_set is not None
        self._attachments.detach_all()
        self._wait_set.stop()
        runtime.close_pools()
        futures.close_bridge(runtime.loop)
        if self._fifo is not None:
            self._fifo.restore()
        for task in runtime.tasks:
            task.cancel()
        runtime.on_idle(self._finished.set)
