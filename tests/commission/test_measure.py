"""What a commissioning measures, on virtual time: bases whose properties are known."""

from __future__ import annotations

from collections import deque
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from math import log

import pytest

from robotctl.base.errors import Refused
from robotctl.commission import (
    NEAR_S,
    STOP_WITHIN_M,
    STOP_WITHIN_RAD,
    Measured,
    Trial,
    TrialCommand,
    TrialSample,
    Turned,
    file_lines,
    measured,
    measured_lines,
    proposals,
    warnings,
)
from robotctl.config import Config, flat
from robotctl.config.settings import with_setting
from robotctl.kernel.course import Course, Held
from robotctl.kernel.geometry import Pose, wrap_angle
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import ZERO, PublishTwist, Twist
from robotctl.sim import Robot, SimParams
from robotctl.testing.kernels import ready
from tests.support.heard_drives import PERFECT

NS_PER_MS = 1_000_000
EXACT = replace(PERFECT, lag_s=0.1)
SPEED_MPS = 0.1
TURN_RPS = 0.3

MOTIONS = {
    500: Held(SPEED_MPS, 0.0, 10.0),
    5000: Held(SPEED_MPS, 0.0, 2.0, quiet_s=2.0),
    11_000: Held(0.0, TURN_RPS, 10.0),
}
"""Each motion by the millisecond in which it begins."""

STOPS, RESETS, END = (2500, 13_000), (4500, 15_000), 16_000


@dataclass
class Base:
    """A base of 1 kHz; commands reach it late, and odometry is told late."""

    sim: SimParams = EXACT
    dead_s: float = 0.0
    rate_hz: int = 50
    deadband_mps: float = 0.0
    turns: bool = True

    def trial(self) -> Trial:
        """Return the motions of a commissioning, driven by the kernel."""
        bench, robot = ready(), Robot(self.sim)
        trial = Trial()
        late: deque[tuple[int, Twist]] = deque()
        begin_ms = bench.t_ns // NS_PER_MS
        for step in range(END):
            t_ms = begin_ms + step
            bench.t_ns = t_ms * NS_PER_MS
            while late and late[0][0] <= t_ms:
                _, twist = late.popleft()
                robot.command(twist if self._obeys(twist) else ZERO)
            robot.advance(0.001)
            if step % (1000 // self.rate_hz) == 0:
                bench.odometry(robot.odometry)
                trial.sample(TrialSample(t_ms / 1e3, robot.odometry, 0.002))
            if step % 1000 == 0:
                bench.battery(1.0)
            if step in MOTIONS:
                trial.begin(MOTIONS[step], t_ms / 1e3)
                bench.drive(course=Course(held=MOTIONS[step]))
                assert bench.state.mode is Mode.MOVING
            if step in STOPS:
                effects = bench.request(Mode.ERROR.value)
            elif step in RESETS:
                effects = bench.request(Mode.IDLE.value)
            elif step % 20 == 0:
                effects = bench.tick()
            else:
                continue
            for effect in effects:
                if isinstance(effect, PublishTwist):
                    late.append((t_ms + round(1e3 * self.dead_s), effect.twist))
                    twist = effect.twist
                    trial.command(TrialCommand(t_ms / 1e3, twist.linear, twist.angular))
        return trial

    def _obeys(self, twist: Twist) -> bool:
        if twist.linear == 0.0:
            return self.turns
        return abs(twist.linear) >= self.deadband_mps


@pytest.mark.parametrize(
    ("rate_hz", "lag_s", "dead_s"),
    [(5, 0.1, 0.2), (10, 0.0, 0.0), (20, 0.3, 0.05), (50, 0.1, 0.0)],
)
def test_the_delay_the_stop_and_the_timeout_are_those_of_the_base(
    rate_hz: int, lag_s: float, dead_s: float
) -> None:
    told = measured(Base(replace(EXACT, lag_s=lag_s), dead_s, rate_hz).trial())
    delay_s = lag_s + dead_s
    assert told.odometry_hz == pytest.approx(rate_hz, rel=0.01)
    assert told.odometry_gap_s == pytest.approx(1.0 / rate_hz)
    assert told.odometry_delay_s == pytest.approx(0.002)
    assert told.reached_mps == pytest.approx(SPEED_MPS, rel=0.03)
    assert told.command_delay_s == pytest.approx(delay_s, abs=0.025)
    assert told.stopping_m == pytest.approx(SPEED_MPS * delay_s, abs=0.003)
    settled_s = lag_s * log(lag_s / NEAR_S) if lag_s else 0.0
    assert told.stopping_s == pytest.approx(dead_s + settled_s, abs=1.0 / rate_hz + 0.02)
    assert told.base_timeout_s == pytest.approx(0.5, abs=0.03)
    turn = told.turn
    assert turn is not None
    assert turn.reached_rps == pytest.approx(TURN_RPS, rel=0.03)
    assert turn.command_delay_s == pytest.approx(delay_s, abs=0.025)
    assert turn.stopping_rad == pytest.approx(TURN_RPS * delay_s, abs=0.009)
    assert turn.stopping_s == pytest.approx(dead_s + settled_s, abs=1.0 / rate_hz + 0.02)
    assert list(warnings(told)) == []


@cache
def _usual() -> Trial:
    return Base().trial()


@pytest.fixture
def usual() -> Trial:
    """The trial of a usual base, which a test may change."""
    return deepcopy(_usual())


def test_a_base_that_cannot_turn_on_its_place_keeps_its_limit_and_is_told_so() -> None:
    told = measured(Base(turns=False).trial())
    assert told.turn is None
    (warning,) = warnings(told)
    assert warning.startswith("the base did not turn on its place")
    assert "turning        not on its place" in measured_lines(told)
    assert "limits.angular_rps" not in proposed(told)


def test_a_base_whose_wheels_are_farther_apart_than_it_thinks_is_warned_of() -> None:
    told = measured(Base(replace(EXACT, actuation_angular_factor=0.8)).trial())
    assert list(warnings(told)) == [
        "the base turned at 80% of the commanded rate: see its wheel separation"
    ]


def test_a_base_that_turns_the_other_way_is_refused_with_a_cure() -> None:
    with pytest.raises(Refused, match=r"-0\.\d+ rad/s where 0\.3 was .* wheels are swapped"):
        measured(Base(replace(EXACT, actuation_angular_factor=-1.0)).trial())


def test_a_turn_beyond_half_a_circle_is_measured_as_one(usual: Trial) -> None:
    motion = usual.motions[2]
    angle_rad = motion.way()[-1][1]
    for number, each in enumerate(motion.samples):
        beyond = wrap_angle(each.pose.theta + 3.0)
        motion.samples[number] = each._replace(pose=Pose(0.0, 0.0, beyond))
    assert motion.way()[-1][1] == pytest.approx(angle_rad)


def test_the_timeout_of_a_base_is_measured() -> None:
    told = measured(Base(replace(EXACT, command_timeout_s=1.5)).trial())
    assert told.base_timeout_s == pytest.approx(1.5, abs=0.03)


def test_a_base_that_goes_on_without_a_command_is_warned_of() -> None:
    told = measured(Base(replace(EXACT, command_timeout_s=10.0)).trial())
    assert told.base_timeout_s is None
    (warning,) = warnings(told)
    assert "went on for 2 s without a command" in warning
    assert "base timeout   none within 2 s" in measured_lines(told)


def test_a_base_that_does_not_move_is_refused_with_a_cure() -> None:
    with pytest.raises(Refused, match=r"0\.000 m/s where 0\.1 m/s was commanded"):
        measured(Base(deadband_mps=0.2).trial())


def test_a_base_that_does_not_stop_is_refused(usual: Trial) -> None:
    last = usual.motions[0].samples
    last[:] = [each._replace(pose=Pose(0.1 * each.t_s, 0.0)) for each in last]
    with pytest.raises(Refused, match="still moving when the motion was over"):
        measured(usual)


@pytest.mark.parametrize("clock_s", [3600.0, -3600.0])
def test_a_clock_that_is_an_hour_off_makes_the_delay_unknown(clock_s: float, usual: Trial) -> None:
    usual.samples[:] = [each._replace(delay_s=0.002 + clock_s) for each in usual.samples]
    told = measured(usual)
    assert told.odometry_delay_s is None
    (warning,) = warnings(told)
    assert "differs by" in warning
    assert "its clock is another" in measured_lines(told)[0]


def test_a_base_whose_wheels_are_smaller_than_it_thinks_is_warned_of() -> None:
    told = measured(Base(replace(EXACT, actuation_linear_factor=0.8)).trial())
    assert list(warnings(told)) == [
        "the base drove 80% of the commanded speed: see its wheel parameters"
    ]


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_another_number_of_motions_is_refused(count: int, usual: Trial) -> None:
    usual.motions = (usual.motions * 2)[:count]
    with pytest.raises(Refused, match="not the three of a commissioning"):
        measured(usual)


@pytest.mark.parametrize("motion", [0, 1, 2])
def test_a_motion_without_odometry_is_refused(motion: int, usual: Trial) -> None:
    usual.motions[motion].samples.clear()
    with pytest.raises(Refused, match="too few to measure"):
        measured(usual)


TURNED = Turned(0.3, 0.3, 0.1, 0.03, 0.2)
BASE = Measured(50.0, 0.02, 0.002, 0.0, 0.1, 0.1, 0.1, 0.01, 0.2, 0.5, 2.0, TURNED)


def proposed(base: Measured, present: KernelParams | None = None) -> dict[str, float]:
    return {each.key: each.value for each in proposals(base, present or KernelParams())}


def test_a_usual_base_keeps_the_defaults() -> None:
    defaults = flat(Config())
    changed = {key: value for key, value in proposed(BASE).items() if value != defaults[key]}
    assert changed == {"tracking.lag_s": 0.1}


def test_a_slow_base_gets_lower_gains_a_longer_lead_and_a_lower_speed() -> None:
    slow = replace(BASE, command_delay_s=0.4, stopping_m=0.05, odometry_hz=5.0, odometry_gap_s=0.3)
    values = proposed(slow)
    assert values["tracking.lag_s"] == 0.4
    assert (values["tracking.k_x"], values["tracking.k_y"]) == (1.75, 5.0)
    assert values["tracking.k_theta"] == 2.5
    assert values["odometry.timeout_s"] == 2.0
    speed = values["limits.linear_mps"]
    assert speed * 0.5 + speed**2 / 2.0 == pytest.approx(STOP_WITHIN_M, abs=0.01)


def test_a_base_that_turns_late_gets_less_steering_and_a_lower_rate() -> None:
    slow = replace(BASE, turn=replace(TURNED, command_delay_s=0.4, stopping_rad=0.15))
    values = proposed(slow)
    assert (values["tracking.k_y"], values["tracking.k_theta"]) == (5.0, 2.5)
    assert (values["tracking.k_x"], values["tracking.lag_s"]) == (3.5, 0.1)
    rate = values["limits.angular_rps"]
    assert rate * 0.5 + rate**2 / 8.0 == pytest.approx(STOP_WITHIN_RAD, abs=0.01)


def test_no_proposal_is_above_what_is_configured_now() -> None:
    careful = with_setting(with_setting(Config(), "limits.linear_mps", 0.2), "tracking.k_x", 1.0)
    values = proposed(BASE, careful.kernel)
    assert (values["limits.linear_mps"], values["tracking.k_x"]) == (0.2, 1.0)


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 5.0])
@pytest.mark.parametrize("gap_s", [0.001, 100.0])
@pytest.mark.parametrize("stopping_m", [0.0, 50.0])
def test_every_proposal_is_allowed(delay_s: float, gap_s: float, stopping_m: float) -> None:
    turn = replace(TURNED, command_delay_s=delay_s, stopping_rad=stopping_m)
    extreme = replace(
        BASE, command_delay_s=delay_s, odometry_gap_s=gap_s, stopping_m=stopping_m, turn=turn
    )
    config = Config()
    for each in proposals(extreme, config.kernel):
        config = with_setting(config, each.key, each.value)


def test_the_file_keeps_the_other_settings_and_tells_what_was_measured() -> None:
    settings = {"command.topic": 'a"b', "tracking.lag_s": 0.3, "guard": True}
    lines = list(file_lines("r2", BASE, settings, proposals(BASE, KernelParams())))
    assert 'command.topic: "a\\"b"' in lines
    assert "guard: true" in lines
    assert sum(line.startswith("tracking.lag_s:") for line in lines) == 1
    assert any("0.50 s after the last command" in line for line in lines)
