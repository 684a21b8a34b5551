"""QoS profiles of our publishers and subscriptions."""

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

from robotctl.kernel.constants import NS_PER_S

COMMAND = QoSProfile(depth=10)
"""Reliable and volatile, as ros2_control and Nav2 expect of a velocity command."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""A late subscriber gets the last message."""

SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Best effort, which matches any publisher."""

JOURNAL = QoSProfile(depth=1000)

MARK = QoSProfile(depth=100)

DIAGNOSTICS = QoSProfile(depth=10)

ROSOUT = QoSProfile(
    depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10)
)
"""As `rcl_qos_profile_rosout_default`."""

SERVICE_EVENTS = QoSProfile(depth=100)
"""For introspection topics, where each call makes two events."""

REQUESTS = QoSProfile(depth=1_500)
"""For a service that must lose no request. rclpy's depth of 10 would lose the oldest."""

PARAMETERS = QoSProfile(depth=10)
"""For parameter services. rclpy's depth of 1000 would take 0.3 MB more for each node."""

# If it is short, even RELIABLE drops messages (rmw_fastrtps). For the limit see docs/design.md.
RECORDING_DEPTH = 1_500
"""The depth of a recording subscription's queue."""

MONITOR = QoSProfile(depth=RECORDING_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For a subscription that matches every publisher of a topic."""

RECORDING_DEPTH_BULKY = 100
"""For images and point clouds, of which a deeper queue could fill the memory."""


def recording(offered: Iterable[QoSProfile], *, bulky: bool) -> QoSProfile:
    """Return the profile for a recorder, which matches every publisher in `offered`.

    `bulky` is true for images and the like. As in rosbag2, the profile is reliable or transient
    local only if all publishers offer that.
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
    """Return the profile of an additional subscription for latched messages, None if not needed."""
    offers = list(offered)
    latched = [each for each in offers if each.durability is DurabilityPolicy.TRANSIENT_LOCAL]
    return recording(latched, bulky=bulky) if 0 < len(latched) < len(offers) else None


def to_yaml(offered: Iterable[QoSProfile]) -> str:
    """Return the profiles in the form of `offered_qos_profiles` of rosbag2 (metadata version 9)."""
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


def words(profile: QoSProfile) -> dict[str, str | int]:
    """Return reliability, durability, history and depth of a profile, in the words of rosbag2."""
    return {
        "reliability": _RELIABILITY.get(profile.reliability, "unknown"),
        "durability": _DURABILITY.get(profile.durability, "unknown"),
        "history": _HISTORY.get(profile.history, "unknown"),
        "depth": profile.depth,
    }


_LIVELINESS = {
    LivelinessPolicy.SYSTEM_DEFAULT: "automatic",  # our own profiles have it; DDS means automatic
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
