"""The channels that a view offers, and the viewers that subscribe to each; no socket."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from robotctl.view.foxglove_messages import ViewChannel
from robotctl.view.foxglove_requests import WrongRequest
from robotctl.view.viewer import Viewer

MAX_SUBSCRIPTIONS: Final = 10_000
"""Limit on the subscriptions of one viewer."""


class OfferedChannels:
    """Channels by id, with their subscriptions; an id is never used again."""

    def __init__(self) -> None:
        self._channels: dict[int, ViewChannel] = {}
        self._last_id = 0
        self._subscribers: dict[int, dict[Viewer, int]] = {}
        """Channel id -> viewer -> the viewer's subscription id."""

    @property
    def channels(self) -> Collection[ViewChannel]:
        """The channels that are offered."""
        return self._channels.values()

    def offer(self, topic: str, type_name: str, definition: str) -> ViewChannel:
        """Add a channel for a topic, and return it."""
        self._last_id += 1
        channel = ViewChannel(self._last_id, topic, type_name, definition)
        self._channels[channel.id] = channel
        return channel

    def withdraw(self, channel_id: int) -> None:
        """Remove a channel, and end its subscriptions."""
        del self._channels[channel_id]
        for viewer, subscription in self._subscribers.pop(channel_id, {}).items():
            del viewer.subscriptions[subscription]

    def subscribers(self, channel_id: int) -> Mapping[Viewer, int] | None:
        """Return the subscribers of a channel with their subscription ids, None without any."""
        return self._subscribers.get(channel_id)

    def subscribe(self, viewer: Viewer, subscription: int, channel_id: int) -> bool:
        """Begin a subscription, and return whether the channel is still offered.

        Raises:
            WrongRequest: The id is taken, the viewer has the channel, or has too many.
        """
        if channel_id not in self._channels:
            return False
        watching = self._subscribers.get(channel_id, {})
        taken = subscription in viewer.subscriptions or viewer in watching
        if taken or len(viewer.subscriptions) >= MAX_SUBSCRIPTIONS:
            raise WrongRequest(f"subscription {subscription}: one a channel, each with its own id")
        viewer.subscriptions[subscription] = channel_id
        watching[viewer] = subscription
        self._subscribers[channel_id] = watching
        return True

    def unsubscribe(self, viewer: Viewer, subscription: int) -> int | None:
        """End a subscription; return its channel if that has no other subscriber, else None."""
        channel_id = viewer.subscriptions.pop(subscription, None)
        if channel_id is None:
            return None
        watching = self._subscribers[channel_id]
        del watching[viewer]
        if watching:
            return None
        del self._subscribers[channel_id]
        return channel_id
