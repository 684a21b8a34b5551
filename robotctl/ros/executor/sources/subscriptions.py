"""Subscriptions: taken as bytes past rclpy, and made into messages where a callback wants these."""

from __future__ import annotations

import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from types import CoroutineType
from typing import Any

from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.subscription import Subscription

from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.decoder import decoder_of
from robotctl.ros.executor.errors import RclCallFailed
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.serialized_taker import SerializedTaker
from robotctl.ros.executor.sources.source import EventFdSource, TakeFailed, rest_of
from robotctl.ros.executor.time_limits import (
    CALM_VERDICT_NS,
    FASTEST_TOPIC_HZ,
    FLOOD_REST_S,
    FLOODED_VERDICT_NS,
    LOOKS_PER_VERDICT,
    SLOW_CALLBACK_NS,
)


class _TakenSource(EventFdSource):
    """Whatever is taken serialized, message by message, until nothing is left."""

    announcements = (Announcement.MESSAGE,)

    def __init__(
        self, runtime: Runtime, subscription: Subscription, where: str, *, views: bool = False
    ) -> None:
        super().__init__(runtime, subscription, subscription.handle, where)
        self._taker = SerializedTaker(self.handle.pointer, views=views)

    def receiver(self) -> Callable[..., Any]:
        """What is called with a `TakenMessage`, field by field."""
        raise NotImplementedError

    def detach(self) -> None:
        if not self.closed:
            self._taker.free()
        super().detach()

    def take(self) -> Any:
        try:
            return self._taker.take()
        except RclCallFailed as error:
            raise TakeFailed(error) from error

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        return rest_of(self.receiver()(*item))

    def drain(self) -> bool:
        if self._strict:
            return super().drain()
        # The same as there, for speed without its calls.
        runtime = self.runtime
        take, receive = self._taker.take, self.receiver()
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
                runtime.drained(self)
                return False
            result = None
            try:
                result = receive(*item)
            except Exception as error:  # noqa: BLE001 - handed to the one handler
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
            if now > end:
                return self.to_be_continued()


class SubscriptionSource(_TakenSource):
    """A subscription, typed or raw, with a callback of one argument or two.

    One that comes faster than 2 kHz, and has a queue of 100 or more, moves into a pool, and back
    when it has calmed down: its messages then collect for two milliseconds, which saves a third
    of what each of them costs.
    """

    def __init__(self, runtime: Runtime, subscription: Subscription, where: str) -> None:
        super().__init__(runtime, subscription, where)
        self._decode = bytes if subscription.raw else decoder_of(subscription.msg_type)
        self._looks = 0
        self._judged_ns = 0
        self._rest_s = affordable_rest_s(FLOOD_REST_S, subscription.qos_profile)

    def receiver(self) -> Callable[..., Any]:
        subscription, decode, info = self.entity, self._decode, self._taker.info
        callback = subscription.callback
        if subscription._callback_type is Subscription.CallbackType.MessageOnly:
            return lambda data, *_: callback(decode(data))
        return lambda data, *_: callback(decode(data), info())

    def drain(self) -> bool:
        self._looks += 1
        if self._looks >= LOOKS_PER_VERDICT:
            self._judge_rate()
        return super().drain()

    def _judge_rate(self) -> None:
        now = time.monotonic_ns()
        took_ns = now - self._judged_ns
        self._looks, self._judged_ns = 0, now
        if self.pool is None and self._rest_s > 0.0 and took_ns < FLOODED_VERDICT_NS:
            with suppress(OSError):  # Without a descriptor for the pool it goes on as it is.
                self.listen(self.runtime.pool(self._rest_s))
        elif self.pool is not None and took_ns > CALM_VERDICT_NS:
            self.listen(None)


class RawTapSource(_TakenSource):
    """A raw subscription with a `RawTap`: straight into the sink."""

    path = "eventfd, collected"

    def __init__(self, runtime: Runtime, subscription: Subscription, where: str) -> None:
        super().__init__(runtime, subscription, where, views=subscription.callback.views)
        rest_s = affordable_rest_s(subscription.callback.latency_s, subscription.qos_profile)
        if rest_s > 0.0:
            self.pool = runtime.pool(rest_s)

    def attach(self) -> None:
        super().attach()
        self.entity.callback.look = self.look_now

    def look_now(self) -> None:
        """Take what has come by now; nothing where nothing was announced."""
        if not self.closed:
            with suppress(BlockingIOError):
                self.look()

    def receiver(self) -> Callable[..., Any]:
        sink: Callable[..., Any] = self.entity.callback.sink
        return sink


def affordable_rest_s(wanted_s: float, qos: QoSProfile) -> float:
    """Return how long messages may collect: at most `wanted_s`, and until the queue may be full.

    0 where that is less than FLOOD_REST_S: so short a rest saves nothing. Sources whose rests are
    equal share a pool.
    """
    if qos.history == HistoryPolicy.KEEP_ALL:
        return wanted_s
    rest_s = min(wanted_s, qos.depth / FASTEST_TOPIC_HZ)
    return rest_s if rest_s >= min(wanted_s, FLOOD_REST_S) else 0.0
