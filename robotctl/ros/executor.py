# mypy: disallow-untyped-calls=False
"""AsyncioExecutor: rclpy's callbacks in the asyncio loop, without a spinning thread.

Where an rclpy executor builds a wait set for every message, this one lets rcl write to an eventfd
that asyncio watches (see `robotctl.ros.rcl`). Nodes, entities and callbacks stay plain rclpy:

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
import inspect
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from itertools import chain
from types import TracebackType
from typing import Any, NoReturn, Self

from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.client import Client
from rclpy.context import Context
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from rclpy.utilities import get_default_context

from robotctl.ros import futures
from robotctl.ros.actions import ActionClientSource, ActionServerSource
from robotctl.ros.entities import ClientSource, QosEventSource, ServiceSource, Source
from robotctl.ros.proof import prove
from robotctl.ros.raw import RawTap
from robotctl.ros.realtime import FifoScheduling, check_priority
from robotctl.ros.runtime import ExceptionHandler, Runtime, log
from robotctl.ros.subscriptions import RawTapSource, SubscriptionSource
from robotctl.ros.timers import TimerSource
from robotctl.ros.waitset import GuardSource, WaitableSource, WaitSetThread

SERVICE_POLL_S = 0.02


class ExecutorTask(Future):
    """What `create_task` returns: an rclpy Future whose `cancel` reaches the running coroutine."""

    def __init__(self, executor: AsyncioExecutor) -> None:
        super().__init__(executor=executor)
        self._owner = executor
        self._asyncio_task: asyncio.Task[None] | None = None

    def cancel(self) -> None:
        """Cancel the future, and the coroutine behind it; from any thread."""
        super().cancel()
        if self._asyncio_task is not None:
            self._owner._in_loop(self._asyncio_task.cancel)


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
        self._nodes: dict[Node, None] = {}
        self._sources: dict[Any, Source] = {}
        self._broken: set[Any] = set()
        self._runtime: Runtime | None = None
        self._thread_id: int | None = None
        self._wait_set: WaitSetThread | None = None
        self._waiting_tasks: list[Callable[[], object]] = []
        self._sync_scheduled = False
        self._is_shutdown = False
        self._closed = False
        self._served = asyncio.Event()
        self._finished = threading.Event()

    # The life of an executor.

    async def __aenter__(self) -> Self:
        """Begin to run callbacks in the running loop.

        Raises:
            UnsupportedPlatform: eventfds do not work here.
            RuntimeError: the executor is open or was closed, or its context is not initialized.
        """
        self._refuse_closed()
        if self._runtime is not None:
            raise RuntimeError("this executor is open already; an executor serves one loop, once")
        if not self._context.ok():
            raise RuntimeError("the executor's context is not initialized; call rclpy.init() first")
        loop = asyncio.get_running_loop()
        await prove(self._context)
        self._runtime = Runtime(loop, self._sync, self._on_exception)
        self._thread_id = threading.get_ident()
        self._wait_set = WaitSetThread(self._runtime, self._context, self._close)
        futures.open_bridge(loop)
        try:
            if self._fifo_priority is not None:
                self._fifo = FifoScheduling(self._fifo_priority)
                log.info("the loop's thread runs under %s", self._fifo.description)
            self._context.on_shutdown(self._on_context_shutdown)
            if get_current_signal_handlers_options() != SignalHandlerOptions.NO:
                self._wait_set.watch_signals()
            self._sync()
        except BaseException:
            self._close()
            raise
        waiting, self._waiting_tasks = self._waiting_tasks, []
        for start in waiting:
            start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
        runtime.stale = True
        # Not at once: a signal handler may run in the midst of what would be torn down.
        runtime.loop.call_soon_threadsafe(self._close)
        if self._in_loop_thread():
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
        if node in self._nodes:
            return False
        other = _executor_of(node)
        if other is not None and other is not self and not getattr(other, "_is_shutdown", False):
            raise RuntimeError(
                f"node {node.get_fully_qualified_name()} belongs to another executor; "
                "call its remove_node first"
            )
        # First, because the setter calls this method again.
        self._nodes[node] = None
        _set_executor(node, self)
        self.wake()
        return True

    def remove_node(self, node: Node) -> None:
        """Run the node's callbacks no more; a node that is not here is ignored."""
        if node not in self._nodes:
            return
        del self._nodes[node]
        if _executor_of(node) is self:
            _set_executor(node, None)
        if self._in_loop_thread():
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
        task = ExecutorTask(self)
        if inspect.iscoroutine(callback):
            self._in_loop(lambda: self._start_coroutine(task, callback))
        else:
            self._in_loop(lambda: self._start_function(task, callback, args, kwargs))
        return task

    def wake(self) -> None:
        """Look at the nodes again: an entity was created or destroyed. rclpy calls this."""
        runtime = self._runtime
        if runtime is None or self._is_shutdown:
            return
        runtime.stale = True
        if not self._in_loop_thread():
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
        if client not in self._sources:
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

    def _in_loop_thread(self) -> bool:
        return threading.get_ident() == self._thread_id

    def _in_loop(self, callback: Callable[[], object]) -> None:
        if self._runtime is None:
            self._waiting_tasks.append(callback)
        elif self._in_loop_thread():
            self._runtime.loop.call_soon(callback)
        else:
            self._runtime.loop.call_soon_threadsafe(callback)

    def _start_function(
        self, task: ExecutorTask, function: Any, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> None:
        if task.cancelled() or self._is_shutdown:
            self._resolve(task, lambda: Future.cancel(task))
            return
        assert self._runtime is not None
        begun = time.monotonic_ns()
        try:
            result = function(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 - in the future, and reported
            self._fail(task, error, _name(function))
            return
        finally:
            self._runtime.slow.check(f"task {_name(function)}", time.monotonic_ns() - begun)
        if inspect.iscoroutine(result):
            self._start_coroutine(task, result)
        else:
            self._resolve(task, lambda: task.set_result(result))

    def _start_coroutine(self, task: ExecutorTask, coroutine: Coroutine[Any, Any, Any]) -> None:
        async def run() -> None:
            try:
                result = await coroutine
            except Exception as error:  # noqa: BLE001 - in the future, and reported
                self._fail(task, error, _name(coroutine))
            else:
                self._resolve(task, lambda: task.set_result(result))

        def finished() -> None:
            coroutine.close()
            if not task.done():
                self._resolve(task, lambda: Future.cancel(task))

        if task.cancelled() or self._is_shutdown:
            finished()
            return
        assert self._runtime is not None
        task._asyncio_task = self._runtime.spawn(run(), f"task {_name(coroutine)}", finished)

    def _fail(self, task: ExecutorTask, error: Exception, name: str) -> None:
        somebody_listens = bool(task._callbacks)
        self._resolve(task, lambda: task.set_exception(error))
        if not somebody_listens:
            task.exception()  # Reported here: rclpy need not print it as well.
            self._report(error, f"task {name}")

    def _resolve(self, task: ExecutorTask, settle: Callable[[], None]) -> None:
        later = None if self._is_shutdown else self
        with futures.callbacks_at_once(task, futures.CallbacksNow(self._report), later):
            settle()

    def _report(self, error: Exception, where: str) -> None:
        if self._runtime is not None:
            self._runtime.report(error, where)

    def _sync_if_stale(self) -> None:
        self._sync_scheduled = False
        if self._runtime is not None and self._runtime.stale:
            self._sync()

    def _sync(self) -> None:
        """Attach what is new on the nodes, detach what is gone."""
        runtime = self._runtime
        if runtime is None:
            return
        if self._is_shutdown:
            self._close()
            return
        runtime.stale = False
        present: dict[Any, Node] = {}
        for node in list(self._nodes):
            if _is_destroyed(node.handle):
                del self._nodes[node]
            else:
                present.update(dict.fromkeys(_entities_of(node), node))
        for entity in [entity for entity in self._sources if entity not in present]:
            source = self._sources.pop(entity)
            if _is_destroyed(source.handle):
                _fail_pending(source, "destroyed while a call waited for its response")
            source.detach()
        self._broken.intersection_update(present)
        for entity, node in present.items():
            if entity not in self._sources and entity not in self._broken:
                self._attach(entity, node, runtime)

    def _attach(self, entity: Any, node: Node, runtime: Runtime) -> None:
        try:
            source = self._make(entity, node, runtime)
            source.attach()
        except InvalidHandle:
            return  # Destroyed between its node's list and here.
        except Exception as error:  # noqa: BLE001 - handed to the one handler
            self._broken.add(entity)
            runtime.report(error, f"{type(entity).__name__}, which therefore stays silent")
            return
        self._sources[entity] = source
        log.debug("%s comes by %s", source.where, source.path)

    def _make(self, entity: Any, node: Node, runtime: Runtime) -> Source:
        """The source for an entity of the node: which path it takes is decided here."""
        wait_set = self._wait_set
        assert wait_set is not None
        name = node.get_fully_qualified_name()
        match entity:
            case Subscription(raw=True, callback=RawTap()):
                return RawTapSource(runtime, entity, f"{name}: tap of {entity.topic_name}")
            case Subscription():
                where = f"{name}: subscription {entity.topic_name} ({_name(entity.callback)})"
                return SubscriptionSource(runtime, entity, where)
            case Service():
                where = f"{name}: service {entity.service_name} ({_name(entity.callback)})"
                return ServiceSource(runtime, entity, where)
            case Client():
                return ClientSource(runtime, entity, f"{name}: client {entity.service_name}", self)
            case Timer():
                period_s = entity.timer_period_ns / 1e9
                where = f"{name}: timer of {period_s:g} s ({_name(entity.callback)})"
                return TimerSource(runtime, entity, where)
            case GuardCondition():
                where = f"{name}: guard condition ({_name(entity.callback)})"
                return GuardSource(runtime, entity, where, wait_set)
            case EventHandler():
                where = f"{name}: event {entity.event_type.name} ({_name(entity.callback)})"
                return QosEventSource(runtime, entity, where)
            case ActionServer():
                where = f"{name}: action server ({_name(entity._execute_callback)})"
                return ActionServerSource(runtime, entity, where, self)
            case ActionClient():
                where = f"{name}: action client {entity._action_name}"
                return ActionClientSource(runtime, entity, where, self)
            case _:
                where = f"{name}: {type(entity).__name__}"
                return WaitableSource(runtime, entity, where, wait_set, self)

    def _on_context_shutdown(self) -> None:
        # In any thread, with the context's lock held: only ask the loop.
        if not self._is_shutdown:
            with suppress(RuntimeError):  # The loop is closed: nothing is left to let go of.
                self._in_loop(self._close)

    def _close(self) -> None:
        self._is_shutdown = True
        if self._closed:
            return
        self._closed = True
        self._served.set()
        nodes, self._nodes = self._nodes, {}
        for node in nodes:
            if _executor_of(node) is self:
                _set_executor(node, None)
        waiting, self._waiting_tasks = self._waiting_tasks, []
        for start in waiting:
            start()
        if self._runtime is None:
            self._finished.set()
        else:
            self._tear_down(self._runtime)

    def _tear_down(self, runtime: Runtime) -> None:
        sources, self._sources = self._sources, {}
        for source in sources.values():
            _fail_pending(source, "the executor was shut down while a call waited")
            source.detach()
        assert self._wait_set is not None
        self._wait_set.stop()
        runtime.close_pools()
        futures.close_bridge(runtime.loop)
        if self._fifo is not None:
            self._fifo.restore()
        for task in runtime.tasks:
            task.cancel()
        runtime.on_idle(self._finished.set)


def _entities_of(node: Node) -> Iterator[Any]:
    return chain(
        node.subscriptions,
        node.timers,
        node.clients,
        node.services,
        node.guards,
        node.waitables,
    )


def _executor_of(node: Node) -> Any:
    # rclpy's types know its own executors only.
    return node.executor


def _set_executor(node: Any, executor: AsyncioExecutor | None) -> None:
    node.executor = executor


def _name(callback: Any) -> str:
    """What a log calls a callback."""
    name = getattr(callback, "__qualname__", None)
    return name if isinstance(name, str) else repr(callback)


def _is_destroyed(handle: Any) -> bool:
    try:
        with handle:
            return False
    except InvalidHandle:
        return True


def _fail_pending(source: Source, reason: str) -> None:
    if isinstance(source, ClientSource | ActionClientSource):
        source.fail_pending(reason)
