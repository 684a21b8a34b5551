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

    The changes are computed here from the counts: rmw_fastrtps announces what happened before the
    attachment, but resets the change (`RMWSubscriptionEvent::set_on_new_event_callback` sets it to
    zero).
    """

    announcements = (Announcement.QOS_EVENT,)
    # `attach` handles earlier events: taking the status again would report an event twice.
    drains_first = False

    def __init__(self, runtime: Runtime, handler: EventHandler, where: str) -> None:
        super().__init__(runtime, handler, getattr(handler, "_EventHandler__event"), where)  # noqa: B009

        self._counts: dict[str, int] = {}
        """The counts of the last status that the callback got."""

    def attach(self) -> None:
        # Before the callback is set, the middleware still reports the changes.
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
    """Return the counts that have a change; for an incompatible type, rclpy has the change only."""
    return {name: count for name, count in fields.items() if f"{name}_change" in fields}
