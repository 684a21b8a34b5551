"""Quality of service: what our publishers offer, what our subscriptions ask for."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.duration import Duration, Infinite
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from robotctl.kernel.units import NS_PER_S

COMMAND = QoSProfile(depth=10)
"""Reliable, volatile, as ros2_control and Nav2 expect of a velocity command."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""A late subscriber still gets the last message."""

SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""What real robots publish, and what a subscription asks for that takes any publisher."""

JOURNAL = QoSProfile(depth=1000)

MARK = QoSProfile(depth=100)

DIAGNOSTICS = QoSProfile(depth=10)

SERVICE_EVENTS = QoSProfile(depth=100)
"""Reliable, as a record of who asked for what should be; a call is two events."""

REQUESTS = QoSProfile(depth=1_500)
"""Of a service that loses no request: so many wait to be taken, and as many answers to be received,
before one overwrites another. rclpy's default is 10."""

RECORDING_DEPTH = 1_500
"""RELIABLE with a shallow queue still drops (rmw_fastrtps). Of a deep one Fast DDS 2.14 searches at
each message all that wait (`History::get_change_nts`), and may never catch up: of 45,000 messages a
second none were lost with 1,500, and three quarters with 3,000."""

MONITOR = QoSProfile(depth=RECORDING_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of a subscription that hears every publisher of a topic, whatever each offers."""

RECORDING_DEPTH_BULKY = 100
"""Of images and the like: where they come faster than they are taken, more of them fill any memory,
before the recorder's own queue can begin to drop and count."""


def recording(offered: Iterable[QoSProfile], *, bulky: bool) -> QoSProfile:
    """Return what a recorder asks for, so that it matches every publisher and loses least.

    As rosbag2 does: reliable only if all publishers are, transient local only if all are.
    """
    offers = list(offered)
    reliable = all(offer.reliability is ReliabilityPolicy.RELIABLE for offer in offers)
    latched = bool(offers) and all(
        offer.durability is DurabilityPolicy.TRANSIENT_LOCAL for offer in offers
    )
    return QoSProfile(
        depth=RECORDING_DEPTH_BULKY if bulky else RECORDING_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def recording_latched(offered: Iterable[QoSProfile], *, bulky: bool) -> QoSProfile | None:
    """Return what a recorder asks for besides, to get what some of the publishers have latched.

    None where `recording` gets it already, or nobody latches anything.
    """
    offers = list(offered)
    latched = [each for each in offers if each.durability is DurabilityPolicy.TRANSIENT_LOCAL]
    return recording(latched, bulky=bulky) if 0 < len(latched) < len(offers) else None


def to_yaml(offered: Iterable[QoSProfile]) -> str:
    """Return the profiles as rosbag2 (metadata version 9) writes `offered_qos_profiles`."""
    return "\n".join(_one_yaml(offer) for offer in offered)


_HISTORY = {HistoryPolicy.KEEP_LAST: "keep_last", HistoryPolicy.KEEP_ALL: "keep_all"}
_RELIABILITY = {
    ReliabilityPolicy.RELIABLE: "reliable",
    ReliabilityPolicy.BEST_EFFORT: "best_effort",
}
_DURABILITY = {
    DurabilityPolicy.TRANSIENT_LOCAL: "transient_local",
    DurabilityPolicy.VOLATILE: "volatile",
}
_LIVELINESS = {
    LivelinessPolicy.SYSTEM_DEFAULT: "automatic",  # what a profile of ours says, and DDS means
    LivelinessPolicy.AUTOMATIC: "automatic",
    LivelinessPolicy.MANUAL_BY_TOPIC: "manual_by_topic",
}


def _one_yaml(offer: QoSProfile) -> str:
    return (
        f"- history: {_HISTORY.get(offer.history, 'unknown')}\n"
        f"  depth: {offer.depth}\n"
        f"  reliability: {_RELIABILITY.get(offer.reliability, 'unknown')}\n"
        f"  durability: {_DURABILITY.get(offer.durability, 'unknown')}\n"
        f"  deadline:\n{_duration_yaml(offer.deadline)}"
        f"  lifespan:\n{_duration_yaml(offer.lifespan)}"
        f"  liveliness: {_LIVELINESS.get(offer.liveliness, 'unknown')}\n"
        f"  liveliness_lease_duration:\n{_duration_yaml(offer.liveliness_lease_duration)}"
        f"  avoid_ros_namespace_conventions: false"
    )


def _duration_yaml(duration: Duration) -> str:
    nanoseconds = duration.nanoseconds
    if nanoseconds in (0, Infinite.nanoseconds):
        sec, nsec = 9_223_372_036, 854_775_807
    else:
        sec, nsec = divmod(nanoseconds, NS_PER_S)
    return f"    sec: {sec}\n    nsec: {nsec}\n"
