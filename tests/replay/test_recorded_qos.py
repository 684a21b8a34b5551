"""A replay offers the recorded quality of service, as far as it can be understood."""

from __future__ import annotations

import pytest
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from robotctl.ros.messages.qos import LATCHED, SENSOR, to_yaml
from robotctl.ros.playback.playback import (
    MAX_DEPTH,
    VOLATILE_DEPTH,
    latched_depth,
    replay_qos,
)

OLD = """\
- history: 3
  depth: 0
  reliability: 1
  durability: 1
  deadline: {sec: 2147483647, nsec: 4294967295}
  lifespan: {sec: 10, nsec: 0}
  liveliness: 1
"""


@pytest.mark.parametrize("offered", [QoSProfile(depth=7), LATCHED, SENSOR])
def test_our_own_recordings_give_back_what_was_offered(offered: QoSProfile) -> None:
    qos = replay_qos(to_yaml([offered]))
    assert (qos.reliability, qos.durability) == (offered.reliability, offered.durability)
    assert qos.depth >= offered.depth
    assert qos_check_compatible(qos, offered)[0] != QoSCompatibility.ERROR


def test_the_numbers_of_older_recorders_mean_the_same() -> None:
    qos = replay_qos(OLD)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.lifespan.nanoseconds == 10_000_000_000
    assert qos.deadline.nanoseconds == QoSProfile(depth=1).deadline.nanoseconds
    assert latched_depth(OLD) == 1


def test_of_several_publishers_the_strongest_counts_for_every_subscriber_to_match() -> None:
    qos = replay_qos(to_yaml([SENSOR]) + "\n" + to_yaml([LATCHED]) + "\n" + OLD)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert qos.lifespan.nanoseconds == QoSProfile(depth=1).lifespan.nanoseconds
    for asked in (SENSOR, LATCHED, QoSProfile(depth=1)):
        assert qos_check_compatible(qos, asked)[0] != QoSCompatibility.ERROR


def test_at_full_speed_few_messages_are_kept_and_latched_ones_as_recorded() -> None:
    assert replay_qos(to_yaml([QoSProfile(depth=7)])).depth == VOLATILE_DEPTH
    assert replay_qos(to_yaml([QoSProfile(depth=7)]), most=5).depth == 5
    latched = to_yaml([QoSProfile(depth=7, durability=DurabilityPolicy.TRANSIENT_LOCAL)])
    assert replay_qos(latched, most=5).depth == 7


@pytest.mark.parametrize(
    "offered",
    ["", "[]", "- 3", "- history: [", "[" * 1000, "- {depth: -4, deadline: {sec: -1}}", "- a: b"],
)
def test_what_cannot_be_understood_is_reliable_and_volatile(offered: str) -> None:
    qos = replay_qos(offered)
    assert qos.reliability is ReliabilityPolicy.RELIABLE
    assert qos.durability is DurabilityPolicy.VOLATILE
    assert latched_depth(offered) == 0


def test_a_file_does_not_choose_how_much_memory_is_taken() -> None:
    assert replay_qos(f"- depth: {10**30}\n  durability: transient_local").depth == MAX_DEPTH
