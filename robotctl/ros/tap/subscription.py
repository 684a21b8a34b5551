"""The subscription of one tapped topic."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.type_support import check_for_type_support

from robotctl.messages.installed import UnusableType, installed_type, parse_type_name
from robotctl.ros import qos
from robotctl.ros.executor import RawTap, SerializedData, ViewSink
from robotctl.ros.graph import endpoints
from robotctl.ros.message_types import message_class, subscribe_raw

MAX_PUBLISHERS = 1024
"""Limit on the remembered publishers of a topic. Latched messages of others may repeat."""

MAX_GAPS = 32
"""Limit on the remembered gaps in the numbers of one publisher."""


@dataclass(slots=True)
class Delivered:
    """Which sequence numbers of one publisher were delivered: all up to `last` except `gaps`."""

    last: int = 0
    gaps: list[range] = field(default_factory=list)

    def add(self, sequence: int) -> bool:
        """Mark a sequence number as delivered, and return whether it is new."""
        if sequence > self.last:
            if sequence > self.last + 1:
                self.gaps = [*self.gaps, range(self.last + 1, sequence)][-MAX_GAPS:]
            self.last = sequence
            return True
        for index, gap in enumerate(self.gaps):
            if sequence in gap:
                parts = range(gap.start, sequence), range(sequence + 1, gap.stop)
                self.gaps[index : index + 1] = filter(None, parts)
                return True
        return False


class LatchedMerge:
    """Removes repeated messages before a sink. Messages with sequence number 0 always pass."""

    def __init__(self, sink: ViewSink) -> None:
        self._sink = sink
        self._delivered: dict[bytes, Delivered] = {}

    def __call__(
        self, data: SerializedData, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Pass a message on unless it is a repeat."""
        known = self._delivered.get(gid)
        if known is None:
            if len(self._delivered) >= MAX_PUBLISHERS:
                del self._delivered[next(iter(self._delivered))]
            known = self._delivered[gid] = Delivered()
        if not sequence or known.add(sequence):
            self._sink(data, received_ns, source_ns, sequence, gid)


def offered_types(node: Node, topic: str) -> dict[str, list[QoSProfile]]:
    """Map each published type of a topic to its publishers' QoS, the most frequent type first."""
    found: dict[str, list[QoSProfile]] = {}
    for info in endpoints.publishers(node, topic):
        found.setdefault(info.topic_type, []).append(info.qos_profile)
    return dict(sorted(found.items(), key=lambda entry: (-len(entry[1]), entry[0])))


LATENCY_S = 0.05
"""How long messages are collected, since it costs less to handle them together."""

Requests = tuple[QoSProfile, QoSProfile | None]
"""The QoS of the subscription, and of a second one for latched messages, or None."""


class TappedSubscription:
    """Passes the messages of one topic to the function `sink`, until `close`."""

    def __init__(
        self,
        node: Node,
        topic: str,
        type_name: str,
        sink: ViewSink,
        offered: Sequence[QoSProfile],
        latency_s: float = LATENCY_S,
    ) -> None:
        """Subscribe to publishers that offer these profiles. Collect messages for `latency_s`."""
        self.topic = topic
        self.type_name = type_name
        self.publishers = 0
        """The number of publishers at the last look at the graph. `Tap` sets it."""

        self.abandoned_since: float | None = None
        """When the topic lost its last publisher [steady s], or None while it has one."""

        self._node = node
        self._latency_s = latency_s
        self._sink = sink
        self._merge = LatchedMerge(sink)
        self._subscriptions: list[Any] = []
        self._requests = self._requests_for(offered)
        self._subscribe(self._requests)

    @property
    def is_latched(self) -> bool:
        """Whether a new subscription to the topic would get latched messages."""
        requested, latched = self._requests
        return latched is not None or requested.durability is DurabilityPolicy.TRANSIENT_LOCAL

    def adapt(self, offered: Sequence[QoSProfile]) -> None:
        """Subscribe again, with a loss of messages, if the profiles `offered` require another QoS.

        Raises:
            Exception: rclpy could not subscribe; the next call tries again.
        """
        requests = self._requests_for(offered)
        if requests != self._requests or not self._subscriptions:
            self.close()
            self._subscribe(requests)
            self._requests = requests

    def close(self) -> None:
        """Destroy the subscriptions."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def _subscribe(self, requests: Requests) -> None:
        try:
            for sink, requested in self._sinks(requests):
                self._subscriptions.append(self._create(sink, requested))
        except BaseException:
            self.close()  # one alone would record a part of the messages as if it were all
            raise

    # A transient-local subscription gets nothing of volatile publishers, a volatile one no latched
    # messages (DDS 1.4, 2.2.3.4). Subscribing again delivers latched messages again.
    def _sinks(self, requests: Requests) -> Iterator[tuple[ViewSink, QoSProfile]]:
        requested, latched = requests
        if latched is not None:
            yield self._merge, requested
            yield self._merge, latched
        elif requested.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            yield self._merge, requested
        else:
            yield self._sink, requested

    def _requests_for(self, offered: Sequence[QoSProfile]) -> Requests:
        bulky = installed_type(self.type_name).holds_bytes
        return qos.recording(offered, bulky=bulky), qos.recording_latched(offered, bulky=bulky)

    def _create(self, sink: ViewSink, requested: QoSProfile) -> Any:
        tap = RawTap(sink, latency_s=self._latency_s, views=True)
        return subscribe_raw(self._node, message_class(self.type_name), self.topic, tap, requested)


SLOW_LOAD_S = 2.0
"""The time after which a load of a type is slow, so that others may begin. 0.1 s is usual."""

# Each competes with the loop for the GIL.
MAX_LOADS = 4
"""Limit on simultaneous loads. Another begins only if all others are slow."""

MAX_REMEMBERED = 4096
"""Limit on remembered results, as other processes may announce any number of types."""


class TypeLoader:
    """Loads message types in daemon threads. Used in the loop's thread only."""

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        """Type -> the reason for a failed load, or "" if it is loaded."""

        self._waiting: dict[str, None] = {}
        self._loading: dict[str, float] = {}
        """Type -> the start of its load on the steady clock [s]."""

        self._all_loaded = asyncio.Event()

    def problem(self, type_name: str) -> str | None:
        """Return "" if a type is loaded, None while it is loading, or the reason for a failure.

        The reason continues the text "type T, which". The first call for a type starts its load.
        """
        known = self._problems.get(type_name)
        if known is not None:
            return known
        if type_name not in self._waiting and type_name not in self._loading:
            try:
                parse_type_name(type_name)
            except UnusableType as error:
                return str(error)
            self._waiting[type_name] = None
        self._load_next()
        return self._problems.get(type_name)

    def is_slow(self, type_name: str) -> bool:
        """Return whether a type has been loading for more than SLOW_LOAD_S."""
        since_s = self._loading.get(type_name)
        return since_s is not None and time.monotonic() - since_s > SLOW_LOAD_S

    async def pause(self, at_most_s: float) -> None:
        """Sleep for `at_most_s` seconds, or less if a load ends and no other type waits to load."""
        self._all_loaded.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await self._all_loaded.wait()

    def _load_next(self) -> None:
        loop = asyncio.get_running_loop()
        while (
            self._waiting
            and len(self._loading) < MAX_LOADS
            and all(map(self.is_slow, self._loading))
        ):
            type_name = next(iter(self._waiting))
            del self._waiting[type_name]
            thread = threading.Thread(
                target=self._load, args=(loop, type_name), name="message type", daemon=True
            )
            try:
                thread.start()
            except RuntimeError as error:  # the limit on threads is reached
                self._remember(type_name, f"cannot be loaded ({error})")
            else:
                self._loading[type_name] = time.monotonic()

    def _load(self, loop: asyncio.AbstractEventLoop, type_name: str) -> None:
        problem = load_type(type_name)
        with suppress(RuntimeError):  # the loop is closed: nothing waits for the type
            loop.call_soon_threadsafe(self._loaded, type_name, problem)

    def _loaded(self, type_name: str, problem: str) -> None:
        del self._loading[type_name]
        self._remember(type_name, problem)
        self._load_next()
        if not self._waiting:
            self._all_loaded.set()

    def _remember(self, type_name: str, problem: str) -> None:
        if len(self._problems) >= MAX_REMEMBERED:
            del self._problems[next(iter(self._problems))]
        self._problems[type_name] = problem


def load_type(type_name: str) -> str:
    """Load a type for a subscription. Return the reason for a failure, or ""."""
    try:
        check_for_type_support(message_class(type_name))
        installed_type(type_name)
    except UnusableType as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 - also SystemExit: foreign modules run here
        return f"cannot be loaded ({type(error).__name__}: {error})"
    return ""
