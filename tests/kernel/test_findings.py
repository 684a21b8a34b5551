"""Each finding holds the names and figures that the operator needs.

A stop and a refusal carry their cause and their remedies as data, without a command line.
After a short stall the drive continues from zero; a long stall stops the robot.
Other nodes on the velocity command: foreign publishers, and missing subscriptions.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

from robotctl.kernel.constants import NS_PER_S, TWIST, TWIST_STAMPED
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import BatteryParams, CommandParams, KernelParams, Stamping
from robotctl.kernel.safety import (
    RULE_OF,
    RULES,
    Finding,
    Rule,
    failed_start_condition,
    remedies_for,
    remedies_to_move,
    start_conditions,
    uncleared,
)
from robotctl.kernel.state import CommandTopic, Health, OdometrySources, SecondOdometry
from robotctl.kernel.types import (
    RESETTING,
    ZERO,
    Cause,
    CommandListenersSeen,
    DriveEnded,
    FaultReported,
    ForeignCommandHeard,
    LoopStalled,
    ModeChanged,
    Odometry,
    Phase,
    PublishTwist,
    Remedy,
)
from robotctl.testing.kernels import (
    Bench,
    in_mode,
    moving,
    ready,
    reset,
    start,
    stopped_by,
    stopping,
)
from tests.support.cases import for_each

NOW_NS = 100_000_000_000
PARAMS = KernelParams()
HEALTHY = Health(
    odometry=Odometry(ORIGIN, ZERO, 1), odometry_t_ns=NOW_NS, battery_level=0.9, battery_t_ns=NOW_NS
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
    (Cause.ODOMETRY_LOST, replace(HEALTHY, odometry=None), "no odometry was received on odom yet"),
    (
        Cause.ODOMETRY_LOST,
        replace(HEALTHY, odometry_t_ns=NOW_NS - 2_000_000_000),
        "no odometry on odom for 2.00 s",
    ),
    (Cause.SECOND_ODOMETRY, two_sources(0.0, 0.0), TWO),
    (
        Cause.ODOMETRY_CONTRADICTED,
        two_sources(0.6, 0.1),
        f"{TWO}, and they are 0.60 m and 0.10 rad apart",
    ),
    (Cause.ODOMETRY_CONTRADICTED, two_sources(nan, 0.1), f"{TWO}, and they are not both finite"),
    (Cause.ODOMETRY_CONTRADICTED, two_sources(0.6, nan), f"{TWO}, and they are not both finite"),
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
    (Cause.TICK_OVERRUN, replace(HEALTHY, tick_gap_s=-0.4), "the steady clock went back by 0.40 s"),
]


@for_each(("cause", "health", "said"), FINDINGS)
def test_a_finding_names_what_is_wrong(cause: Cause, health: Health, said: str) -> None:
    finding = uncleared(cause, health, PARAMS, NOW_NS)
    assert finding is not None
    assert finding.detail == said
    assert finding.rule is RULE_OF[cause]


@for_each("cause", Cause)
def test_nothing_is_found_in_a_healthy_robot(cause: Cause) -> None:
    for health in (HEALTHY, listeners(None), listeners(1), listeners(2, "a/msg/A")):
        assert uncleared(cause, health, PARAMS, NOW_NS) is None


@for_each("cause", [Cause.BATTERY_LOW, Cause.BATTERY_UNKNOWN])
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


def test_a_battery_at_its_stop_level_is_said_with_both_levels() -> None:
    low = RULE_OF[Cause.BATTERY_LOW].check
    said = "the battery is at 15%, at or below 15%"
    assert low(replace(HEALTHY, battery_level=0.15), PARAMS, NOW_NS) == said
    assert low(replace(HEALTHY, battery_level=0.16), PARAMS, NOW_NS) == ""
    assert low(replace(HEALTHY, battery_level=nan), PARAMS, NOW_NS) == ""


def effects_of(bench: Bench, kind: type) -> list[object]:
    return [effect for effect in bench.effects if isinstance(effect, kind)]


def test_a_fault_names_its_cause_in_the_change_of_mode_and_at_the_end_of_the_drive() -> None:
    bench = moving()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    changed, ended = effects_of(bench, ModeChanged)[-1], effects_of(bench, DriveEnded)[-1]
    assert isinstance(changed, ModeChanged)
    assert isinstance(ended, DriveEnded)
    assert (
        (changed.reason, changed.cause)
        == (ended.reason, ended.cause)
        == ("KeyError", Cause.TASK_DIED)
    )


def test_a_change_of_mode_without_a_fault_has_no_cause() -> None:
    bench = stopping()
    bench.run(60)
    changed, ended = effects_of(bench, ModeChanged)[-1], effects_of(bench, DriveEnded)[-1]
    assert isinstance(changed, ModeChanged)
    assert isinstance(ended, DriveEnded)
    assert changed.mode is Mode.IDLE
    assert (changed.cause, ended.cause) == (None, None)


def test_a_request_that_waits_for_a_ramp_is_told_what_to_do_about_a_fault() -> None:
    bench = stopping()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    (refused,) = (reply for reply in bench.replies if not reply.ok)
    assert refused.message == "the mode became ERROR: KeyError"
    assert refused.remedies == (Remedy.READ_LOG_AND_RESTART,)


def test_a_cause_that_is_not_gone_is_told_with_its_remedy() -> None:
    bench = moving()
    bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, "KeyError"))
    bench.request(Mode.IDLE)
    assert bench.replies[-1].message == "the cause of ERROR is not gone: KeyError"
    assert bench.replies[-1].remedies == (Remedy.READ_LOG_AND_RESTART,)


def test_a_moving_robot_must_be_stopped_first() -> None:
    bench = in_mode(Mode.MOVING)
    bench.drive()
    assert bench.replies[-1].remedies == (Remedy.STOP_OR_REPLACE,)
    assert not reset(bench)
    assert bench.replies[-1].remedies == (Remedy.STOP_FIRST,)


@for_each("rule", RULES)
def test_the_last_remedy_before_a_robot_moves_again_is_a_reset(rule: Rule) -> None:
    remedies = remedies_to_move(rule.cause)
    assert remedies_for(rule.cause) == remedies[:1]
    assert remedies[-1] in RESETTING
    assert not RESETTING.intersection(remedies[:-1])


LIMIT_S = KernelParams().max_tick_gap_s


def stall(bench: Bench, seconds: float) -> None:
    """Stall the loop; the watchdog reports it before any other event."""
    bench.t_ns += round(seconds * NS_PER_S)
    bench.give(LoopStalled(bench.t_ns, seconds, 3, 1, "in read_text (pathlib.py:1058)"))


def test_after_a_short_stall_the_command_ramps_up_from_zero() -> None:
    bench = moving(ticks=40)
    before = bench.state.command
    assert before.linear > 0.3
    stall(bench, 0.25)
    assert bench.state.mode is Mode.MOVING
    assert bench.state.command == ZERO
    bench.commands.clear()
    limits = KernelParams().limits
    speed = 0.0
    for _ in range(10):
        bench.odometry(bench.state.drive.reference().pose)  # type: ignore[union-attr]
        (effect,) = bench.tick()
        assert isinstance(effect, PublishTwist)
        assert 0.0 <= effect.twist.linear - speed <= limits.linear_accel_mps2 * 0.02 + 1e-9
        speed = effect.twist.linear
    assert speed > 0.05


@for_each("seconds", [LIMIT_S + 0.01, 3.0, float("nan")])
def test_a_stall_beyond_the_tick_gap_stops_a_moving_robot_and_names_the_culprit(
    seconds: float,
) -> None:
    bench = moving()
    bench.give(LoopStalled(bench.t_ns, seconds, 3, 1, "in read_text (pathlib.py:1058)"))
    assert stopped_by(bench, Cause.LOOP_STALLED, Mode.ERROR)
    assert "in read_text (pathlib.py:1058)" in bench.state.reason
    assert reset(bench)  # it is over


def test_a_stall_as_long_as_the_tick_gap_is_still_short() -> None:
    bench = moving()
    stall(bench, LIMIT_S)
    assert bench.state.mode is Mode.MOVING


@for_each("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
@for_each("seconds", [0.2, 3.0])
def test_a_stall_of_a_robot_that_stands_is_counted_and_no_more(mode: Mode, seconds: float) -> None:
    bench = in_mode(mode)
    bench.effects.clear()
    for count in (1, 2):
        stall(bench, seconds)
        assert bench.state.health.stalls.count == count
    stalls = bench.state.health.stalls
    assert (stalls.last_t_ns, stalls.last_s) == (bench.t_ns, seconds)
    assert bench.state.mode is mode
    assert not any(isinstance(effect, ModeChanged) for effect in bench.effects)


def test_a_ramp_down_that_stalls_has_ended() -> None:
    bench = moving(ticks=40)
    bench.request(Mode.IDLE)
    assert bench.state.phase is Phase.STOPPING
    stall(bench, 0.2)
    bench.tick()
    assert bench.state.mode is Mode.IDLE
    assert bench.replies[-1].ok


def test_one_foreign_command_stops_a_moving_robot_in_the_same_step() -> None:
    bench = moving()
    bench.give(ForeignCommandHeard(bench.t_ns, "/teleop"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)
    assert "/teleop also published a velocity command" in bench.state.reason
    assert not reset(bench)
    bench.run(51)  # 1.02 s
    assert reset(bench)


def test_no_start_where_no_node_takes_the_command() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    assert "no node subscribes to cmd_vel" in start(bench)
    bench.give(CommandListenersSeen(bench.t_ns, 1, ()))
    assert not start(bench)


def test_a_robot_that_wants_another_type_is_refused_with_that_type() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, (TWIST_STAMPED,)))
    assert f"takes {TWIST_STAMPED} on cmd_vel" in start(bench)


@for_each(("ours", "other"), [(TWIST, TWIST_STAMPED), (TWIST_STAMPED, TWIST)])
def test_no_start_where_both_types_are_taken_and_none_is_configured(ours: str, other: str) -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 1, (other,), ours))
    assert f"some nodes take {TWIST} on cmd_vel, others {TWIST_STAMPED}" in start(bench)
    bench.give(CommandListenersSeen(bench.t_ns, 1, ("a/msg/A",), ours))
    assert not start(bench)


@for_each("stamped", [Stamping.TRUE, Stamping.FALSE])
def test_a_configured_type_is_sent_also_where_both_are_taken(stamped: Stamping) -> None:
    bench = ready(KernelParams(command=CommandParams(stamped=stamped)))
    bench.give(CommandListenersSeen(bench.t_ns, 1, (TWIST_STAMPED,)))
    assert not start(bench)


def test_the_type_that_robotctl_sends_is_named() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, (TWIST,), TWIST_STAMPED))
    assert f"takes {TWIST} on cmd_vel, not {TWIST_STAMPED}" in start(bench)


def test_listeners_that_leave_do_not_stop_a_moving_robot_by_themselves() -> None:
    bench = moving()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    assert bench.state.mode is Mode.MOVING
