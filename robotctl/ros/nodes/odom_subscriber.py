"""Receives odometry, and identifies the publisher of each message."""

from __future__ import annotations

import logging
from collections.abc import Callable

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSProfile

from robotctl.base.text import short_name
from robotctl.kernel.params import OdometryQos
from robotctl.kernel.types import Odometry
from robotctl.messages.inputs import FRAME_AT, frame_bytes, frame_id_of, read_odometry
from robotctl.ros import qos
from robotctl.ros.executor import RawTap
from robotctl.ros.graph.endpoints import publisher_names
from robotctl.ros.message_types import subscribe_raw
from robotctl.ros.session import Session

WANTED = {OdometryQos.BEST_EFFORT: qos.SENSOR, OdometryQos.RELIABLE: QoSProfile(depth=10)}
"""The profile for each value of `odometry.qos`."""

MAX_SOURCES = 256
"""Limit on remembered publishers. Above it, the longest silent one is forgotten."""

LOOKS_FOR_NAME = 20
"""The number of times that `find_names` looks for a publisher's node."""


class OdomSubscriber:
    """Node `odom_subscriber`, which receives odometry, by default from publishers of any QoS."""

    def __init__(
        self,
        session: Session,
        topic: str,
        on_odometry: Callable[[Odometry, int, int], None],
        on_source: Callable[[int, str, str, str], None],
        wanted: QoSProfile = qos.SENSOR,
    ) -> None:
        """Call `on_odometry(odometry, source, sequence)` for each message.

        `source` is the number of the publisher, counted from 1, and `sequence` the message's
        sequence number. Before a publisher's first message, `on_source(source, gid, name, frame)`
        gets its gid in hex, its node's name ("" if unknown) and its frame id. `on_source` is called
        again when `find_names` finds the node, or when the frame id changes.
        """
        self._node = session.node("odom_subscriber")
        self._log = logging.getLogger(session.logger_name("odom_subscriber"))
        self._on_odometry = on_odometry
        self._on_source = on_source
        self._sources: dict[bytes, int] = {}
        """A publisher's gid -> its number, in the order of the last messages."""

        self._last_source = 0
        self._last_gid: bytes | None = None
        self._frame = b""
        """The frame id of the last message, as serialized bytes."""

        self._told: dict[bytes, tuple[str, str]] = {}
        """A publisher's gid -> node name and frame id in the last call of `on_source`."""

        self._nameless: dict[bytes, int] = {}
        """Gid of a publisher whose node is unknown -> the number of looks that are left."""

        # A raw tap is fast; it must not collect messages, because the kernel decides on them.
        tap = RawTap(self._receive, latency_s=0.0)
        self._subscription = subscribe_raw(self._node, OdometryMessage, topic, tap, wanted)

        self.look: Callable[[], None] = lambda: tap.poll()
        """Passes the messages that have arrived to `on_odometry` now, not in the next loop turn."""

    @property
    def topic(self) -> str:
        """The full name of the odometry topic."""
        return str(self._subscription.topic_name)

    def count_publishers(self) -> int:
        """Return the present number of publishers of the odometry topic."""
        return int(self._node.count_publishers(self.topic))

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        if gid != self._last_gid or not data.startswith(self._frame, FRAME_AT):
            self._last_gid, self._frame = gid, frame_bytes(data)
            self._sources[gid] = self._sources.pop(gid, 0) or self._number(gid)
            self._tell(gid, frame=short_name(frame_id_of(data)))
        source = self._sources[gid]
        odometry = read_odometry(data)
        if self._log.isEnabledFor(logging.DEBUG):
            self._log.debug("Position: x=%.2f, y=%.2f", odometry.pose.x, odometry.pose.y)
        self._on_odometry(odometry, source, sequence)

    def _number(self, gid: bytes) -> int:
        """Number a new publisher. Above MAX_SOURCES, forget the one that was silent longest."""
        if len(self._sources) >= MAX_SOURCES:
            forgotten = next(iter(self._sources))
            del self._sources[forgotten]
            self._nameless.pop(forgotten, None)
            self._told.pop(forgotten, None)
        self._last_source += 1
        return self._last_source

    def _tell(self, gid: bytes, frame: str) -> None:
        """Call `on_source` if the publisher is new or its frame id has changed."""
        known = self._told.get(gid)
        if known is not None and known[1] == frame:
            return
        name = known[0] if known else publisher_names(self._node, self.topic).get(gid, "")
        if not name and known is None:
            self._nameless[gid] = LOOKS_FOR_NAME
        self._told[gid] = name, frame
        self._on_source(self._sources[gid], gid.hex(), name, frame)

    def find_names(self) -> None:
        """Look up the node names of publishers that had none yet, and report each name found."""
        if not self._nameless:
            return
        names = publisher_names(self._node, self.topic)
        for gid, looks in list(self._nameless.items()):
            name = names.get(gid, "")
            if name:
                frame = self._told[gid][1]
                self._told[gid] = name, frame
                self._on_source(self._sources[gid], gid.hex(), name, frame)
            if name or looks <= 1:
                del self._nameless[gid]
            else:
                self._nameless[gid] = looks - 1
