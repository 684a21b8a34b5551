"""Attaches subscriptions, timers, services and other ROS entities to the asyncio loop.

Each kind of entity has a class in `sources/` that takes its events and runs its callbacks.
"""

from __future__ import annotations

from typing import Any

from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.client import Client
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from robotctl.ros.executor.nodes import is_destroyed
from robotctl.ros.executor.raw_tap import RawTap
from robotctl.ros.executor.runtime import Runtime, log, name_of
from robotctl.ros.executor.sources.actions import ActionClientSource, ActionServerSource
from robotctl.ros.executor.sources.qos_events import QosEventSource
from robotctl.ros.executor.sources.services import ClientSource, ServiceSource
from robotctl.ros.executor.sources.source import Source
from robotctl.ros.executor.sources.subscriptions import RawTapSource, SubscriptionSource
from robotctl.ros.executor.sources.timers import TimerSource
from robotctl.ros.executor.sources.waitables import GuardSource, WaitableSource
from robotctl.ros.executor.sources.waitset import WaitSetThread
from robotctl.ros.executor.time_limits import NS_PER_S


class Attachments:
    """One source for each entity of an executor's nodes; used in the loop's thread only."""

    def __init__(self, runtime: Runtime, wait_set: WaitSetThread, executor: Any) -> None:
        self._runtime = runtime
        self._wait_set = wait_set
        self._executor = executor
        self._broken: set[Any] = set()
        """Entities that could not be attached; they are reported once and not tried again."""
        self.sources: dict[Any, Source] = {}

    def __contains__(self, entity: object) -> bool:
        return entity in self.sources

    def follow(self, present: dict[Any, Node]) -> None:
        """Watch the new entities of `present` (entity -> node) in the loop, and no others."""
        for entity in [entity for entity in self.sources if entity not in present]:
            source = self.sources.pop(entity)
            if is_destroyed(source.handle):
                _fail_pending(source, "destroyed while a call waited for its response")
            source.detach()
        self._broken.intersection_update(present)
        for entity, node in present.items():
            if entity not in self.sources and entity not in self._broken:
                self._attach(entity, node)

    def detach_all(self) -> None:
        """Detach every entity; calls that wait for a response fail."""
        sources, self.sources = self.sources, {}
        for source in sources.values():
            _fail_pending(source, "the executor was shut down while a call waited")
            source.detach()

    def _attach(self, entity: Any, node: Node) -> None:
        try:
            source = self._source_of(entity, node)
            source.attach()
        except InvalidHandle:
            return  # It was destroyed after its node listed it.
        except Exception as error:  # noqa: BLE001 - handed to the one handler
            self._broken.add(entity)
            self._runtime.report(error, f"{type(entity).__name__}, which is not served")
            return
        self.sources[entity] = source
        log.debug("%s is woken by %s", source.where, source.woken_by)

    def _source_of(self, entity: Any, node: Node) -> Source:
        name = node.get_fully_qualified_name()
        runtime, wait_set, executor = self._runtime, self._wait_set, self._executor
        match entity:
            case Subscription(raw=True, callback=RawTap()):
                return RawTapSource(runtime, entity, f"{name}: tap of {entity.topic_name}")
            case Subscription():
                where = f"{name}: subscription {entity.topic_name} ({name_of(entity.callback)})"
                return SubscriptionSource(runtime, entity, where)
            case Service():
                where = f"{name}: service {entity.service_name} ({name_of(entity.callback)})"
                return ServiceSource(runtime, entity, where, node)
            case Client():
                where = f"{name}: client {entity.service_name}"
                return ClientSource(runtime, entity, where, executor)
            case Timer():
                period_s = entity.timer_period_ns / NS_PER_S
                where = f"{name}: timer of {period_s:g} s ({name_of(entity.callback)})"
                return TimerSource(runtime, entity, where)
            case GuardCondition():
                where = f"{name}: guard condition ({name_of(entity.callback)})"
                return GuardSource(runtime, entity, where, wait_set)
            case EventHandler():
                where = f"{name}: event {entity.event_type.name} ({name_of(entity.callback)})"
                return QosEventSource(runtime, entity, where)
            case ActionServer():
                where = f"{name}: action server ({name_of(entity._execute_callback)})"
                return ActionServerSource(runtime, entity, where, executor, node)
            case ActionClient():
                where = f"{name}: action client {entity._action_name}"
                return ActionClientSource(runtime, entity, where, executor)
            case _:
                where = f"{name}: {type(entity).__name__}"
                return WaitableSource(runtime, entity, where, wait_set, executor)


def _fail_pending(source: Source, reason: str) -> None:
    if isinstance(source, ClientSource | ActionClientSource):
        source.fail_pending(reason)
