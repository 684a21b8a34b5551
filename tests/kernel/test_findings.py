"""Each finding holds the names and figures that the operator needs."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.checks import reported
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.params import BatteryParams, KernelParams
from robotctl.kernel.safety import (
    RULE_OF,
    Finding,
    failed_start_condition,
    start_conditions,
    uncleared,
)
from robotctl.kernel.state import CommandTopic, Health, OdometrySources, SecondOdometry
from robotctl.kernel.types import ZERO, Cause, Odometry

NOW_NS = 100_000_000_000
PARAMS = KernelParams()
HEALTHY = Health(
    odometry=Odometry(ORIGIN, ZERO, 1),
    odometry_t_ns=NOW_NS,
    battery_level=0.9,
    battery_t_ns=NOW_NS,
)
NAMES = ((0, "/base"), (2, "/other"))
TWO = "odometry comes from two publishers, /base and /other"


def two_sources(distance_m: float, angle_rad: float) -> Health:
    second = SecondOdometry(2, NOW_NS, distance_m, angle_rad)
    return replace(HEALTHY, odometry_sources=OdometrySources(names=NAMES, second=second))


def listeners(count: int | None, *other_types: str) -> Health:
    topic = CommandTopic(listeners=count, other_types=other_types)
    return replace(HEALTHY, command_topic=topic)


FINDINGS: list[tuple[Cause, Health, str]] = [
    (
        Cause.BATTERY_LOW,
        replace(HEALTHY, battery_level=0.1),
        "the battery is at 10%, not yet at 20%",
    ),
    (
        Cause.BATTERY_LOW,
        replace(HEALTHY, battery_level=None),
        "the battery is at an unknown level, not yet at 20%",
    ),
    (
        Cause.BATTERY_UNKNOWN,
        replace(HEALTHY, battery_level=None),
        "no battery level was received on battery_state yet",
    ),
    (
        Cause.BATTERY_UNKNOWN,
        replace(HEALTHY, battery_level=1.5),
        "the battery reports 1.5, not 0 to 1",
    ),
    (
        Cause.BATTERY_UNKNOWN,
        replace(HEALTHY, battery_level=1.5, battery_in_percent=True),
        "the battery reports 150, not 0 to 100",
    ),
    (
        Cause.BATTERY_UNKNOWN,
        replace(HEALTHY, battery_t_ns=NOW_NS - 6_000_000_000),
        "no battery level for 6.0 s",
    ),
    (
        Cause.ODOMETRY_LOST,
        replace(HEALTHY, odometry=None),
        "no odometry was received on odom yet",
    ),
    (
        Cause.ODOMETRY_LOST,
        replace(HEALTHY, odometry_t_ns=NOW_NS - 2_000_000_000),
        "no odometry on odom for 2.00 s",
    ),
    (
        Cause.SECOND_ODOMETRY,
        two_sources(0.0, 0.0),
        TWO,
    ),
    (
        Cause.ODOMETRY_CONTRADICTED,
        two_sources(0.6, 0.1),
        f"{TWO}, and they are 0.60 m and 0.10 rad apart",
    ),
    (
        Cause.ODOMETRY_CONTRADICTED,
        two_sources(nan, 0.1),
        f"{TWO}, and they are not both finite",
    ),
    (
        Cause.ODOMETRY_CONTRADICTED,
        two_sources(0.6, nan),
        f"{TWO}, and they are not both finite",
    ),
    (
        Cause.ODOMETRY_CONTRADICTED,
        two_sources(1e308, 2.0),
        f"{TWO}, and they are {1e308:.2f} m and 2.00 rad apart",
    ),
    (
        Cause.TRACKING_LOST,
        replace(HEALTHY, path_error_m=0.6),
        "the robot is 0.60 m from where it should be, more than 0.5 m",
    ),
    (
        Cause.TRACKING_LOST,
        replace(HEALTHY, path_error_m=inf),
        "the robot is further from where it should be than the pattern is large",
    ),
    (
        Cause.FOREIGN_PUBLISHER,
        replace(HEALTHY, foreign_publishers=("/a",)),
        "/a also publishes velocity commands",
    ),
    (
        Cause.FOREIGN_PUBLISHER,
        replace(HEALTHY, foreign_publishers=("/a", "/b")),
        "/a, /b also publish velocity commands",
    ),
    (
        Cause.FOREIGN_PUBLISHER,
        replace(HEALTHY, command_topic=CommandTopic(foreign_t_ns=NOW_NS, foreign_by="/a")),
        "/a also published a velocity command",
    ),
    (Cause.COMMAND_UNHEARD, listeners(0), "no node subscribes to cmd_vel"),
    (
        Cause.COMMAND_UNHEARD,
        listeners(0, "a/msg/A", "b/msg/B"),
        "the robot takes a/msg/A, b/msg/B on cmd_vel, not geometry_msgs/msg/Twist",
    ),
    (
        Cause.RECORDER_FAILED,
        replace(HEALTHY, reported=((Cause.RECORDER_FAILED, "the disk is full"),)),
        "the disk is full",
    ),
    (
        Cause.RECORDER_FAILED,
        replace(HEALTHY, reported=((Cause.RECORDER_FAILED, ""),)),
        Cause.RECORDER_FAILED.value,
    ),
    (Cause.TICK_OVERRUN, replace(HEALTHY, tick_gap_s=0.4), "no control tick for 0.40 s"),
    (
        Cause.TICK_OVERRUN,
        replace(HEALTHY, tick_gap_s=-0.4),
        "the steady clock went back by 0.40 s",
    ),
]


@pytest.mark.parametrize(
    ("cause", "health", "said"), FINDINGS, ids=lambda value: getattr(value, "name", "")
)
def test_a_finding_names_what_is_wrong(cause: Cause, health: Health, said: str) -> None:
    finding = uncleared(cause, health, PARAMS, NOW_NS)
    assert finding is not None
    assert finding.detail == said
    assert finding.rule is RULE_OF[cause]


@pytest.mark.parametrize("cause", Cause, ids=lambda cause: cause.name)
def test_nothing_is_found_in_a_healthy_robot(cause: Cause) -> None:
    for health in (HEALTHY, listeners(None), listeners(1), listeners(2, "a/msg/A")):
        assert uncleared(cause, health, PARAMS, NOW_NS) is None


@pytest.mark.parametrize("cause", [Cause.BATTERY_LOW, Cause.BATTERY_UNKNOWN])
def test_a_robot_without_a_battery_topic_has_no_trouble_with_it(cause: Cause) -> None:
    params = replace(PARAMS, battery=BatteryParams(topic=""))
    for level in (None, 0.0, 9.0):
        health = replace(HEALTHY, battery_level=level, battery_t_ns=0)
        assert uncleared(cause, health, params, NOW_NS) is None
        assert not RULE_OF[cause].check(health, params, NOW_NS)


def test_every_start_condition_is_told_with_what_is_wrong_in_the_order_of_the_table() -> None:
    never_checked = {Cause.OPERATOR_STOP, Cause.OPERATOR_ERROR, Cause.LOOP_STALLED}
    wanted = [cause for cause in RULE_OF if cause not in never_checked]
    for health in (HEALTHY, *(health for _, health, _ in FINDINGS)):
        told = start_conditions(health, PARAMS, NOW_NS)
        assert [rule.cause for rule, _ in told] == wanted
        wrong = [Finding(rule, said) for rule, said in told if said]
        assert failed_start_condition(health, PARAMS, NOW_NS) == (wrong[0] if wrong else None)


def test_what_the_daemon_reports_is_told_by_the_check_of_its_own_cause() -> None:
    faults = ((Cause.RECORDER_FAILED, "the disk is full"), (Cause.TASK_DIED, ""))
    health = replace(HEALTHY, reported=faults)
    for cause, said in (
        (Cause.RECORDER_FAILED, "the disk is full"),
        (Cause.TASK_DIED, Cause.TASK_DIED.value),
    ):
        check = reported(cause)
        assert check(health, PARAMS, NOW_NS) == said
        assert check(HEALTHY, PARAMS, NOW_NS) == ""


def test_a_battery_at_its_stop_level_is_said_with_both_levels() -> None:
    low = RULE_OF[Cause.BATTERY_LOW].check
    said = "the battery is at 15%, at or below 15%"
    assert low(replace(HEALTHY, battery_level=0.15), PARAMS, NOW_NS) == said
    assert low(replace(HEALTHY, battery_level=0.16), PARAMS, NOW_NS) == ""
    assert low(replace(HEALTHY, battery_level=nan), PARAMS, NOW_NS) == ""
