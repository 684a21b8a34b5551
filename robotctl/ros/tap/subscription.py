"""The subscription of one tapped topic.

A transient-local subscription gets latched messages, but nothing of volatile publishers; a volatile
one gets new messages of all publishers, but no latched ones (DDS 1.4, 2.2.3.4). So a topic with
both kinds of publisher takes two subscriptions. Subscribing again delivers latched messages again.
"""

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
"""Limit on the publishers of a topic that are remembered; the latched messages of a publisher that
was forgotten may be recorded twice."""

MAX_GAPS = 32
"""Limit on the remembered gaps in the numbers of one publisher."""


@dataclass(slots=True)
class Delivered:
    """The messages of one publisher that reached the sink: up to `last`, without those in `gaps`.

    The number of the first message is 1.
    """

    last: int = 0
    gaps: list[range] = field(default_factory=list)

    def add(self, sequence: int) -> bool:
        """Add a message; return whether it is new."""
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
    """A sink that passes each message on once, even if several subscriptions deliver it.

    A message is always passed on if its sequence number is 0, which means that it has none.
    """

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
    """Return the QoS profiles of a topic's publishers by type, the most frequent type first."""
    found: dict[str, list[QoSProfile]] = {}
    for info in endpoints.publishers(node, topic):
        found.setdefault(info.topic_type, []).append(info.qos_profile)
    return dict(sorted(found.items(), key=lambda entry: (-len(entry[1]), entry[0])))


LATENCY_S = 0.05
"""How long messages are collected, since it costs less to handle them together. The middleware sets
their time stamps, so the recording does not show the delay."""

Requests = tuple[QoSProfile, QoSProfile | None]
"""The QoS of the subscription, and that of the second one for latched messages, if needed."""


class TappedSubscription:
    """Passes the messages of one topic to its sink, until `close`."""

    def __init__(
        self,
        node: Node,
        topic: str,
        type_name: str,
        sink: ViewSink,
        offered: Sequence[QoSProfile],
        latency_s: float = LATENCY_S,
    ) -> None:
        """Subscribe to publishers that offer these profiles; collect messages for `latency_s`."""
        self.topic = topic
        self.type_name = type_name
        self.publishers = 0
        """The number of publishers at the last look at the graph; `Tap` sets it."""

        self.abandoned_since: float | None = None
        """When the topic lost its last publisher [steady s]; None while it has one."""

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
        """Subscribe again if the profiles that the publishers now offer require another QoS.

        Messages that are sent before the new subscription has matched are lost, and count as lost.

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
"""A load of a type that takes longer is slow: other loads no longer wait for it. 0.1 s is usual."""

MAX_LOADS = 4
"""Limit on simultaneous loads. Another one begins only if all running ones are slow, because each
competes with the loop for the GIL."""

MAX_REMEMBERED = 4096
"""Limit on remembered results; other processes may announce any number of types."""


class TypeLoader:
    """Loads message types in daemon threads; used in the loop's thread only.

    If the module of a type raises any exception, the type cannot be loaded. A load that never ends
    does not keep the process alive.
    """

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        """Type -> why it cannot be loaded, or "" if it is loaded."""

        self._waiting: dict[str, None] = {}
        self._loading: dict[str, float] = {}
        """Type -> when its load began, on the steady clock [s]."""

        self._all_loaded = asyncio.Event()

    def problem(self, type_name: str) -> str | None:
        """Return why a type cannot be loaded, "" if it is loaded, None while it is loading.

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
        """Sleep for `at_most_s` seconds, or until a load ends and no type waits to be loaded."""
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
    """Load what a subscription needs of a type; return why the type cannot be loaded, or ""."""
    try:
        check_for_type_support(message_class(type_name))
        installed_type(type_name)
    except UnusableType as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 - also SystemExit: foreign modules run here
        return f"cannot be loaded ({type(error).__name__}: {error})"
    return ""
