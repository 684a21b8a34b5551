"""The QoS that a replay offers, from the QoS that the recorded publishers offered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import yaml
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from robotctl.kernel.units import NS_PER_S

MAX_TEXT: Final = 1 << 20
MAX_DEPTH: Final = 10_000
VOLATILE_DEPTH: Final = 1000
"""The least depth of a volatile topic: subscribers do not see it; a shallow queue loses bursts."""

_INFINITE_SEC: Final = 2_147_483_647
"""What recorders before Jazzy wrote for an infinite time; later ones write a larger number."""

_RELIABILITY = {"1": ReliabilityPolicy.RELIABLE, "2": ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"1": DurabilityPolicy.TRANSIENT_LOCAL, "2": DurabilityPolicy.VOLATILE}
_RELIABILITY |= {policy.short_key: policy for policy in _RELIABILITY.values()}
_DURABILITY |= {policy.short_key: policy for policy in _DURABILITY.values()}
"""Policies by name, and by the numbers of rmw/types.h that rosbag2 wrote before version 9 of its
metadata."""


def replay_qos(offered: str, *, most: int = MAX_DEPTH) -> QoSProfile:
    """Return a profile that matches every subscriber of the recorded publishers.

    `offered` is the `offered_qos_profiles` of a recording. The strongest of several profiles
    counts; text that cannot be read means reliable and volatile. The publisher of a
    volatile topic keeps at most `most` messages.
    """
    profiles = _profiles(offered)
    reliable = ReliabilityPolicy.RELIABLE in [_reliability(each) for each in profiles]
    latched = DurabilityPolicy.TRANSIENT_LOCAL in [_durability(each) for each in profiles]
    reliable = reliable or not profiles
    # DDS does not announce the depth: of a latched topic 1 is assumed, the most common one.
    depth = sum(max(_depth(each), 1) for each in profiles)
    if not latched:
        depth = min(max(depth, VOLATILE_DEPTH), most)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(depth, MAX_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        deadline=_common(profiles, "deadline"),
        lifespan=_common(profiles, "lifespan"),
    )


def latched_depth(offered: str) -> int:
    """Return how many latched messages a late subscriber gets, 0 where the topic is volatile."""
    qos = replay_qos(offered)
    return int(qos.depth) if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL else 0


def _profiles(offered: str) -> Sequence[Mapping[str, Any]]:
    if len(offered) > MAX_TEXT:
        return []
    try:
        found = yaml.safe_load(offered)
    except (yaml.YAMLError, ValueError, RecursionError):
        return []
    return [each for each in found if isinstance(each, dict)] if isinstance(found, list) else []


def _reliability(profile: Mapping[str, Any]) -> ReliabilityPolicy:
    value = str(profile.get("reliability"))
    return _RELIABILITY.get(value, ReliabilityPolicy.RELIABLE)


def _durability(profile: Mapping[str, Any]) -> DurabilityPolicy:
    return _DURABILITY.get(str(profile.get("durability")), DurabilityPolicy.VOLATILE)


def _depth(profile: Mapping[str, Any]) -> int:
    depth = profile.get("depth")
    return min(depth, MAX_DEPTH) if isinstance(depth, int) else 0


def _common(profiles: Sequence[Mapping[str, Any]], policy: str) -> Duration:
    """Return the duration that all profiles have in common, else 0 (unspecified)."""
    spans = {_span_ns(each.get(policy)) for each in profiles}
    return Duration(nanoseconds=spans.pop() if len(spans) == 1 else 0)


def _span_ns(value: object) -> int:
    if not isinstance(value, dict):
        return 0
    sec, nsec = value.get("sec"), value.get("nsec")
    if not isinstance(sec, int) or not isinstance(nsec, int):
        return 0
    if not 0 <= sec < _INFINITE_SEC or not 0 <= nsec < NS_PER_S:
        return 0
    return sec * NS_PER_S + nsec
