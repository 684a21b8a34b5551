"""From the QoS that a recording says its publishers offered to the one that its replay offers."""

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
"""At least so much, for subscribers do not see it, and a shallow queue loses what comes at once."""

_INFINITE_SEC: Final = 2_147_483_647
"""What recorders before Jazzy wrote for `for ever`; later ones wrote more."""

_RELIABILITY = {"1": ReliabilityPolicy.RELIABLE, "2": ReliabilityPolicy.BEST_EFFORT}
_DURABILITY = {"1": DurabilityPolicy.TRANSIENT_LOCAL, "2": DurabilityPolicy.VOLATILE}
_RELIABILITY |= {policy.short_key: policy for policy in _RELIABILITY.values()}
_DURABILITY |= {policy.short_key: policy for policy in _DURABILITY.values()}
"""With the numbers of rmw/types.h, which rosbag2 wrote before version 9 of its metadata."""


def replay_qos(offered: str, *, keep_all: bool = False) -> QoSProfile:
    """What to offer so that every subscriber of the recorded publishers matches again.

    `offered` is the `offered_qos_profiles` of a recording: the strongest of several profiles
    counts, and reliable and volatile where it says nothing that can be understood. `keep_all`
    makes a reliable publisher wait rather than lose a message.
    """
    profiles = _profiles(offered)
    reliable = ReliabilityPolicy.RELIABLE in [_reliability(each) for each in profiles]
    latched = DurabilityPolicy.TRANSIENT_LOCAL in [_durability(each) for each in profiles]
    reliable = reliable or not profiles
    # An unknown depth of a latched topic: DDS does not tell it, and most latch one message.
    depth = sum(max(_depth(each), 1) for each in profiles)
    if not latched:
        depth = max(depth, VOLATILE_DEPTH)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all and reliable else HistoryPolicy.KEEP_LAST,
        depth=min(depth, MAX_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        deadline=_common(profiles, "deadline"),
        lifespan=_common(profiles, "lifespan"),
    )


def latched_depth(offered: str) -> int:
    """How many messages late subscribers still get; 0 for a topic that is not latched."""
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
    """The span of time that all profiles agree on; else none is promised (0 is unspecified)."""
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
