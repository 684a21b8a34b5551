"""The sources of an open executor, one for each entity of its nodes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain
from typing import Any

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
from rclpy.timer import Timer

from robotctl.ros.executor import futures
from robotctl.ros.executor.event_loop import NS_PER_S
from robotctl.ros.executor.loop_thread import FifoScheduling, LoopThread
from robotctl.ros.executor.raw_tap import RawTap
from robotctl.ros.executor.runtime import ExceptionHandler, Runtime, log, name_of
from robotctl.ros.executor.services import (
    ActionClientSource,
    ActionServerSource,
    ClientSource,
    ServiceSource,
)
from robotctl.ros.executor.source import Source, TimerSource
from robotctl.ros.executor.subscriptions import QosEventSource, RawTapSource, SubscriptionSource
from robotctl.ros.executor.waitables import GuardSource, WaitableSource, WaitSetThread


class Nodes:
    """The nodes of one executor. Each node's attribute `executor` is set, as in rclpy."""

    # Any as a node's type: rclpy's types accept only rclpy's own executors.
    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._nodes: dict[Node, None] = {}

    def __iter__(self) -> Iterator[Node]:
        return iter(list(self._nodes))

    def add(self, node: Any) -> bool:
        """Add the node, or return False if it was added before.

        Raises:
            RuntimeError: Another live executor has the node.
        """
        if node in self._nodes:
            return False
        other = node.executor
        if (
            other is not None
            and other is not self._executor
            and not getattr(other, "_is_shutdown", False)
        ):
            raise RuntimeError(
                f"node {node.get_fully_qualified_name()} belongs to another executor; "
                "call its remove_node first"
            )
        # Before the setter, which calls the executor's `add_node` again.
        self._nodes[node] = None
        node.executor = self._executor
        return True

    def remove(self, node: Any) -> bool:
        """Remove the node, or return False if it was not added."""
        try:
            del self._nodes[node]
        except KeyError:
            return False
        if node.executor is self._executor:
            node.executor = None
        return True

    def entities(self) -> dict[Any, Node]:
        """Return entity -> node for all nodes. Destroyed nodes are removed."""
        found: dict[Any, Node] = {}
        for node in self:
            if is_destroyed(node.handle):
                self._nodes.pop(node, None)  # Another thread may have removed it.
            else:
                of_node = (node.subscriptions, node.timers, node.clients, node.services)
                entities = chain(*of_node, node.guards, node.waitables)
                found.update(dict.fromkeys(entities, node))
        return found


def is_destroyed(handle: Any) -> bool:
    """Return whether rclpy has destroyed the object of the handle."""
    try:
        with handle:
            return False
    except InvalidHandle:
        return True


def _fail_pending(source: Source, reason: str) -> None:
    if isinstance(source, ClientSource | ActionClientSource):
        source.fail_pending(reason)


class Engine:
    """Keeps a `Source` attached to each entity of the nodes.

    Any thread may call `wake` and `request_close`. The rest is for the loop's thread.
    """

    def __init__(
        self,
        executor: Any,
        loop: asyncio.AbstractEventLoop,
        loop_thread: LoopThread,
        nodes: Nodes,
        close: Callable[[], None],
        on_exception: ExceptionHandler | None,
    ) -> None:
        """Prepare to run callbacks in `loop`. The engine calls `close` to close the executor."""
        self.runtime = Runtime(loop, self.sync, on_exception)
        self._loop_thread = loop_thread
        self._context: Context = executor.context
        self._nodes = nodes
        self._close = close
        self._wait_set = WaitSetThread(self.runtime, self._context, close)
        self._executor = executor
        self._broken: set[Any] = set()
        """Entities that could not be attached, and are not tried again."""

        self.sources: dict[Any, Source] = {}
        """Entity -> its `Source`, for each attached entity."""

        self._fifo: FifoScheduling | None = None
        self._sync_scheduled = False
        self._closing = False

    @property
    def scheduling(self) -> str:
        """The scheduling policy of the loop's thread, as text."""
        return "SCHED_OTHER" if self._fifo is None else self._fifo.description

    def open(self, fifo_priority: int | None) -> None:
        """Attach the entities, watch for shutdown and, with `fifo_priority`, request SCHED_FIFO."""
        futures.open_bridge(self.runtime.loop)
        if fifo_priority is not None:
            self._fifo = FifoScheduling(fifo_priority)
            log.info("the loop's thread runs under %s", self._fifo.description)
        self._context.on_shutdown(self._on_context_shutdown)
        if get_current_signal_handlers_options() != SignalHandlerOptions.NO:
            self._wait_set.watch_signals()
        self.sync()

    def wake(self) -> None:
        """Attach new entities, and detach those that are gone, in the loop's next turn."""
        if self._closing:
            return
        self.runtime.stale = True
        if not self._loop_thread.is_current():
            with suppress(RuntimeError):  # The loop is closed: there is nothing to look for.
                self.runtime.loop.call_soon_threadsafe(self._sync_if_stale)
        elif not self._sync_scheduled:
            self._sync_scheduled = True
            self.runtime.loop.call_soon(self._sync_if_stale)

    def sync(self) -> None:
        """Attach the new entities of the nodes, and detach those that are gone."""
        if self._closing:
            self._close()
            return
        self.runtime.stale = False
        self._follow(self._nodes.entities())

    def request_close(self) -> None:
        """Begin no more callbacks, and close the executor in a later turn of the loop."""
        self._closing = True
        self.runtime.stale = True
        # Not at once: this may run in a signal handler, amid code that uses what is released.
        self.runtime.loop.call_soon_threadsafe(self._close)

    def close(self, finished: Callable[[], None]) -> None:
        """Detach all entities, fail all calls and cancel all tasks. Then call `finished`."""
        self._closing = True
        sources, self.sources = self.sources, {}
        for source in sources.values():
            _fail_pending(source, "the executor was shut down while a call waited")
            source.detach()
        self._wait_set.stop()
        self.runtime.close_pools()
        futures.close_bridge(self.runtime.loop)
        if self._fifo is not None:
            self._fifo.restore()
        for task in self.runtime.tasks:
            task.cancel()
        self.runtime.on_idle(finished)

    def _follow(self, present: dict[Any, Node]) -> None:
        """Attach the new entities of `present` (entity -> node), and detach all others."""
        for entity in [entity for entity in self.sources if entity not in present]:
            source = self.sources.pop(entity)
            if is_destroyed(source.handle):
                _fail_pending(source, "destroyed while a call waited for its response")
            source.detach()
        self._broken.intersection_update(present)
        for entity, node in present.items():
            if entity not in self.sources and entity not in self._broken:
                self._attach(entity, node)

    def _attach(self, entity: Any, node: Node) -> None:
        try:
            source = self._source_of(entity, node)
            source.attach()
        except InvalidHandle:
            return  # It was destroyed after its node listed it.
        except Exception as error:  # noqa: BLE001 - handed to the one handler
            self._broken.add(entity)
            self.runtime.report(error, f"{type(entity).__name__}, which is not served")
            return
        self.sources[entity] = source
        log.debug("%s is woken by %s", source.where, source.woken_by)

    def _source_of(self, entity: Any, node: Node) -> Source:
        runtime, wait_set, executor = self.runtime, self._wait_set, self._executor
        at = node.get_fully_qualified_name()
        calls = f"({name_of(getattr(entity, 'callback', None))})"
        match entity:
            case Subscription(raw=True, callback=RawTap()):
                return RawTapSource(runtime, entity, f"{at}: tap of {entity.topic_name}")
            case Subscription():
                where = f"{at}: subscription {entity.topic_name} {calls}"
                return SubscriptionSource(runtime, entity, where)
            case Service():
                return ServiceSource(
                    runtime, entity, f"{at}: service {entity.service_name} {calls}", node
                )
            case Client():
                return ClientSource(
                    runtime, entity, f"{at}: client {entity.service_name}", executor
                )
            case Timer():
                period_s = entity.timer_period_ns / NS_PER_S
                return TimerSource(runtime, entity, f"{at}: timer of {period_s:g} s {calls}")
            case GuardCondition():
                where = f"{at}: guard condition {calls}"
                return GuardSource(runtime, entity, entity.handle, where, wait_set)
            case EventHandler():
                return QosEventSource(
                    runtime, entity, f"{at}: event {entity.event_type.name} {calls}"
                )
            case ActionServer():
                where = f"{at}: action server ({name_of(entity._execute_callback)})"
                return ActionServerSource(runtime, entity, where, executor, node)
            case ActionClient():
                where = f"{at}: action client {entity._action_name}"
                return ActionClientSource(runtime, entity, where, executor)
            case _:
                where = f"{at}: {type(entity).__name__}"
                return WaitableSource(runtime, entity, where, wait_set, executor)

    def _sync_if_stale(self) -> None:
        self._sync_scheduled = False
        if self.runtime.stale:
            self.sync()

    def _on_context_shutdown(self) -> None:
        # Runs in any thread, with the context's lock held: only schedule the rest.
        if not self._closing:
            with suppress(RuntimeError):  # The loop is closed: there is nothing to release.
                self._loop_thread.call_soon(self._close)
