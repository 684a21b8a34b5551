"""QoS events: matched, incompatible QoS, message lost, deadline, liveliness."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rclpy.event_handler import EventHandler

from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.sources.source import EventFdSource


class QosEventSource(EventFdSource):
    """A QoS event of a publisher or a subscription.

    What changed is counted here, from the counts themselves: rmw_fastrtps announces what happened
    before the attachment but forgets the change (`RMWSubscriptionEvent::set_on_new_event_callback`
    sets it to zero).
    """

    announcements = (Announcement.QOS_EVENT,)
    # `attach` sees to what was before: to take a status once more would invent an event.
    drains_first = False

    def __init__(self, runtime: Runtime, handler: EventHandler, where: str) -> None:
        super().__init__(runtime, handler, getattr(handler, "_EventHandler__event"), where)  # noqa: B009

        self._told: dict[str, int] = {}
        """The counts that the callback knows."""

    def attach(self) -> None:
        # Until the callback is set the middleware knows what has changed since it was told last.
        with self.handle:
            fields = _fields(self.handle.take_event())
        self._told = {
            name: count - fields[f"{name}_change"] for name, count in _counts(fields).items()
        }
        super().attach()
        if any(value for name, value in fields.items() if name.endswith("_change")):
            self.resume()

    def drain(self) -> bool:
        # A status is always there to be taken, so: once per announcement.
        self.call_back(self._tell)
        return False

    def _tell(self) -> Any:
        status = self.handle.take_event()
        fields = _fields(status)
        counts = _counts(fields)
        changes = {f"{name}_change": count - self._told[name] for name, count in counts.items()}
        self._told = counts
        if "total_count" in counts and not any(changes.values()):
            return None  # Announced after the last status was taken with it.
        if not changes.items() <= fields.items():
            status = SimpleNamespace(**fields | changes)
        return self.entity.callback(status)


def _fields(status: Any) -> dict[str, Any]:
    return {name: getattr(status, name) for name in dir(status) if name[0] != "_"}


def _counts(fields: dict[str, Any]) -> dict[str, int]:
    """What a change is told of; of an incompatible type rclpy tells the change alone."""
    return {name: count for name, count in fields.items() if f"{name}_change" in fields}
