"""Feeds the server from a ROS domain: a separate node subscribes to the topics that are watched."""

from __future__ import annotations

from functools import partial
from typing import Final

from robotctl.ros.session import Session
from robotctl.ros.tap.on_demand import OnDemandTap
from robotctl.view.foxglove import StatusLevel
from robotctl.view.server import ViewServer

_NODE: Final = "_view"
"""The node's name; ROS tools hide names that begin with an underscore."""


class LiveView:
    """Offers the topics of a domain to viewers, and sends messages of the topics they watch."""

    def __init__(self, session: Session, server: ViewServer) -> None:
        self._server = server
        self._channels: dict[str, int] = {}
        self._topics: dict[int, str] = {}
        self._tap = OnDemandTap(session.node(_NODE), self)
        server.on_subscribed = self._subscribed
        server.on_unwatched = self._unwatched

    async def run(self) -> None:
        """Follow the graph until cancelled."""
        await self._tap.run()

    # From the tap

    def appeared(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic."""
        channel_id = self._server.offer(topic, type_name, definition)
        self._channels[topic] = channel_id
        self._topics[channel_id] = topic

    def vanished(self, topic: str) -> None:
        """Withdraw a topic."""
        channel_id = self._channels.pop(topic)
        del self._topics[channel_id]
        self._server.withdraw(channel_id)

    def unusable(self, topic: str, problem: str) -> None:
        """Show viewers the note `problem` on a topic that is not offered; "" removes the note."""
        if problem:
            self._server.note(topic, StatusLevel.WARNING, problem)
        else:
            self._server.clear(topic)

    # From the server

    def _subscribed(self, channel_id: int) -> None:
        """Subscribe to the topic again for a new viewer, which needs the latched messages."""
        self._tap.want(self._topics[channel_id], partial(self._forward, channel_id))

    def _unwatched(self, channel_id: int) -> None:
        topic = self._topics.get(channel_id)
        if topic is not None:
            self._tap.unwant(topic)

    def _forward(
        self, channel_id: int, data: bytes | memoryview, received_ns: int, *_: object
    ) -> None:
        self._server.publish(channel_id, received_ns, data)
