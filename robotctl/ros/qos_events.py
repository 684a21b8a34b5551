"""QoS events: matched, incompatible QoS, message lost, deadline, liveliness."""

from __future__ import annotations

from rclpy.event_handler import EventHandler

from robotctl.ros.rcl import Signal
from robotctl.ros.runtime import Runtime
from robotctl.ros.sources import EventFdSource


class QosEventSource(EventFdSource):
    """A QoS event of a publisher or a subscription."""

    signals = (Signal.QOS_EVENT,)
    # rcl announces what happened before the attachment, and taking twice would invent an event.
    drains_first = False

    def __init__(self, runtime: Runtime, handler: EventHandler, where: str) -> None:
        super().__init__(runtime, handler, getattr(handler, "_EventHandler__event"), where)  # noqa: B009

    def drain(self) -> bool:
        # A status is always there to be taken, so: once per announcement.
        self.call_back(lambda: self.entity.callback(self.handle.take_event()))
        return False
