"""Sources of QoS events and of subscriptions."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Coroutine
from contextlib import suppress
from types import CoroutineType, SimpleNamespace
from typing import Any, Final

from rclpy.event_handler import EventHandler
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.subscription import Subscription

from robotctl.ros.executor.announcements import Announcement, counts_each_message
from robotctl.ros.executor.decoder import Decode, decoder_of
from robotctl.ros.executor.event_loop import (
    CALM_BEYOND_NS,
    FASTEST_TOPIC_HZ,
    FLOOD_REST_S,
    FLOODED_WITHIN_NS,
    POLLS_PER_RATE_CHECK,
    SLOW_CALLBACK_NS,
)
from robotctl.ros.executor.raw_tap import RawTap, SerializedTaker
from robotctl.ros.executor.rcutils import RclCallFailed
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.source import EventFdSource, TakeFailed


class QosEventSource(EventFdSource):
    """Passes the status of a QoS event of a publisher or subscription to its callback."""

    announcements = (Announcement.QOS_EVENT,)
    # `attach` itself handles earlier events; to handle them again would report them twice.
    drains_first = False

    def __init__(self, runtime: Runtime, handler: EventHandler, where: str) -> None:
        super().__init__(runtime, handler, getattr(handler, "_EventHandler__event"), where)  # noqa: B009

        self._counts: dict[str, int] = {}
        """The counts of the previous status."""

    def attach(self) -> None:
        # The middleware still reports the changes now, before its callback is set.
        with self.handle:
            fields = _fields(self.handle.take_event())
        self._counts = {
            name: count - fields[f"{name}_change"] for name, count in _counts_of(fields).items()
        }
        super().attach()
        if any(value for name, value in fields.items() if name.endswith("_change")):
            self.resume()

    def drain(self) -> bool:
        # A status can always be taken, so it is taken once per announcement.
        self.run_callback(self._report)
        return False

    def _report(self) -> Any:
        status = self.handle.take_event()
        fields = _fields(status)
        counts = _counts_of(fields)
        # rmw_fastrtps announces events from before `attach` with changes of zero
        # (`RMWSubscriptionEvent::set_on_new_event_callback`): so compute the changes here.
        changes = {f"{name}_change": count - self._counts[name] for name, count in counts.items()}
        self._counts = counts
        if "total_count" in counts and not any(changes.values()):
            return None  # The last status included the change already.
        if not changes.items() <= fields.items():
            status = SimpleNamespace(**fields | changes)
        return self.entity.callback(status)


def _fields(status: Any) -> dict[str, Any]:
    return {name: getattr(status, name) for name in dir(status) if name[0] != "_"}


def _counts_of(fields: dict[str, Any]) -> dict[str, int]:
    """Return the counts that have a `_change` field."""
    return {name: count for name, count in fields.items() if f"{name}_change" in fields}


UNKNOWN_COUNT: Final = 1 << 62
"""Stands for an unknown number of waiting messages."""


class _TakenSource(EventFdSource):
    """The base class of subscriptions. It takes messages in serialized form."""

    announcements = (Announcement.MESSAGE,)

    def __init__(
        self,
        runtime: Runtime,
        subscription: Subscription,
        where: str,
        *,
        decode: Decode | None,
        views: bool = False,
    ) -> None:
        """Pass `decode(data)` to the receiver, or the fields of a `Taken` if `decode` is None."""
        super().__init__(runtime, subscription, subscription.handle, where)
        self._taker = SerializedTaker(self.handle.pointer, views=views, bare=decode is not None)
        self._decode = decode
        self._callback = subscription.callback
        self._receive = self.receiver_of(self._callback)
        self._counts = counts_each_message()
        self._is_counted = False
        """Whether the count of the eventfd includes all waiting messages."""
        self._polls = 0

    @abstractmethod
    def receiver_of(self, callback: Any) -> Callable[..., Any]:
        """Return the receiver of messages for the subscription's `callback`."""

    def check_rate(self) -> None:
        """Start or stop collecting messages. Called every POLLS_PER_RATE_CHECK polls."""

    def detach(self) -> None:
        if not self.closed:
            self._taker.free()
        super().detach()

    def resume(self) -> None:
        self._is_counted = False
        super().resume()

    def continue_later(self) -> bool:
        self._is_counted = False
        return super().continue_later()

    def take(self) -> Any:
        try:
            return self._taker.take()
        except RclCallFailed as error:
            raise TakeFailed(error) from error

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        decode, receive = self._decode, self._receive
        result = receive(*item) if decode is None else receive(decode(item))
        return result if isinstance(result, CoroutineType) else None

    def drain(self) -> bool:
        self._polls += 1
        if self._polls == POLLS_PER_RATE_CHECK:
            self._polls = 0
            self.check_rate()
        callback = self.entity._callback
        if callback is not self._callback:
            self._callback, self._receive = callback, self.receiver_of(callback)
        if self._custom_group:
            return super().drain()
        # The same as in the base class, but with fewer function calls, for speed.
        runtime, taker = self.runtime, self._taker
        take: Callable[[], Any] = taker.take
        decode, receive = self._decode, self._receive
        # Only the announced number: one more attempt would cost half as much as a message.
        left = self.announced if self._is_counted else UNKNOWN_COUNT
        self._is_counted = self._counts
        clock = time.monotonic_ns
        last = clock()
        end = last + runtime.slice_ns
        while True:
            try:
                item = take()
            except RclCallFailed as error:
                self.retry_later(error)
                return False
            if item is None:
                runtime.mark_drained(self)
                return False
            result = None
            try:
                result = receive(*item) if decode is None else receive(decode(item))
            except Exception as error:  # noqa: BLE001 - goes to the exception handler
                runtime.report(error, self.where)
            now = clock()
            if now - last > SLOW_CALLBACK_NS:
                runtime.slow.check(self.where, now - last)
            last = now
            if result is not None and isinstance(result, CoroutineType):
                self.run_async(result)
                if self.blocked():
                    return False
            if runtime.stale:
                runtime.sync()
                if self.closed:
                    return False
            left -= 1
            if left <= 0 and taker.lent is None:
                if runtime.flooded:
                    runtime.mark_drained(self)
                return False
            if now > end:
                return self.continue_later()


class SubscriptionSource(_TakenSource):
    """Serves a typed or raw subscription. At high rates, a message may wait for FLOOD_REST_S."""

    def __init__(self, runtime: Runtime, subscription: Subscription, where: str) -> None:
        decode = bytes if subscription.raw else decoder_of(subscription.msg_type)
        super().__init__(runtime, subscription, where, decode=decode)
        self._rate_checked_ns = 0
        self._rest_s = affordable_rest_s(FLOOD_REST_S, subscription.qos_profile)

    def receiver_of(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        if self.entity._callback_type is Subscription.CallbackType.MessageOnly:
            return callback
        info = self._taker.info
        return lambda message: callback(message, info())

    def check_rate(self) -> None:
        now = time.monotonic_ns()
        took_ns = now - self._rate_checked_ns
        self._rate_checked_ns = now
        if self.pool is None and self._rest_s > 0.0 and took_ns < FLOODED_WITHIN_NS:
            with suppress(OSError):  # No descriptor for a pool: each message still wakes the loop.
                self.listen(self.runtime.pool(self._rest_s))
        elif self.pool is not None and took_ns > CALM_BEYOND_NS:
            self.listen(None)


class RawTapSource(_TakenSource):
    """Passes the messages of a raw subscription directly to the sink of its `RawTap`."""

    woken_by = "eventfd, collected"

    def __init__(self, runtime: Runtime, subscription: Subscription, where: str) -> None:
        views = subscription.callback.views
        super().__init__(runtime, subscription, where, decode=None, views=views)
        rest_s = affordable_rest_s(subscription.callback.latency_s or 0.0, subscription.qos_profile)
        if rest_s > 0.0:
            self.pool = runtime.pool(rest_s)

    def attach(self) -> None:
        super().attach()
        self.entity.callback.poll = self.poll_now
        if self.entity.callback.latency_s is None:
            self.stop_listening()

    def poll_now(self) -> None:
        """Deliver the messages announced so far."""
        if not self.closed:
            self.poll()

    def receiver_of(self, callback: RawTap) -> Callable[..., Any]:
        return callback.sink


def affordable_rest_s(wanted_s: float, qos: QoSProfile) -> float:
    """Return the longest pause [s] between polls that does not overflow the subscription's queue.

    It is at most `wanted_s`, and 0 if it would be too short to save CPU time.
    """
    if qos.history == HistoryPolicy.KEEP_ALL:
        return wanted_s
    rest_s = min(wanted_s, qos.depth / FASTEST_TOPIC_HZ)
    return rest_s if rest_s >= min(wanted_s, FLOOD_REST_S) else 0.0
