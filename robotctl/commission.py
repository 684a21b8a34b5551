"""Measures a base from three recorded motions, and proposes limits and gains."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import degrees, pi, sqrt
from pathlib import Path
from statistics import fmean, linear_regression, median
from typing import Final, NamedTuple

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.check.journal import read_effect, read_event
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import Held
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import DriveRequested, OdomReceived, PublishTwist
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.read.journal_reader import RecordedEntry, read_journal

_EVENTS = (OdomReceived.__name__, DriveRequested.__name__)


class TrialSample(NamedTuple):
    """A sample of odometry with its arrival (monotonic clock) and the stamp's age on arrival."""

    t_s: float
    pose: Pose
    delay_s: float


class TrialCommand(NamedTuple):
    """A velocity command with its time on the monotonic clock."""

    t_s: float
    linear_mps: float
    angular_rps: float


@dataclass(slots=True)
class Motion:
    """A requested motion, with all commands and odometry until the next request."""

    held: Held
    begin_s: float
    commands: list[TrialCommand] = field(default_factory=list)
    samples: list[TrialSample] = field(default_factory=list)

    @property
    def is_turn(self) -> bool:
        """Whether the request was to turn on the spot."""
        return self.held.linear_mps == 0.0

    @property
    def wanted(self) -> float:
        """The requested velocity: linear [m/s], or angular [rad/s] for a turn on the spot."""
        return self.held.angular_rps if self.is_turn else self.held.linear_mps

    def sent(self) -> list[tuple[float, float]]:
        """Return (time [s], velocity) of each command: in m/s, or in rad/s for a turn."""
        return [(c.t_s, c.angular_rps if self.is_turn else c.linear_mps) for c in self.commands]

    def way(self) -> list[tuple[float, float]]:
        """Return (time [s], displacement) of each odometry sample: in m, or in rad for a turn."""
        begin = self.samples[0].pose if self.samples else ORIGIN
        if not self.is_turn:
            return [(each.t_s, begin.express(each.pose).x) for each in self.samples]
        turned, found, previous = 0.0, [], begin
        for each in self.samples:
            turned += wrap_angle(each.pose.theta - previous.theta)
            previous = each.pose
            found.append((each.t_s, turned))
        return found


@dataclass(slots=True)
class Trial:
    """The odometry of a recording, and its motions at a requested velocity."""

    samples: list[TrialSample] = field(default_factory=list)
    motions: list[Motion] = field(default_factory=list)

    def begin(self, held: Held, t_s: float) -> None:
        """Begin a motion at the velocity `held`, with the last odometry sample before `t_s`."""
        self.motions.append(Motion(held, t_s, samples=self.samples[-1:]))

    def sample(self, sample: TrialSample) -> None:
        """Add an odometry sample to the trial and to its newest motion."""
        self.samples.append(sample)
        if self.motions:
            self.motions[-1].samples.append(sample)

    def command(self, command: TrialCommand) -> None:
        """Add a velocity command to the newest motion; ignore it before the first motion."""
        if self.motions:
            self.motions[-1].commands.append(command)


def read_trial(path: Path) -> Trial:
    """Return the odometry and the motions in the journal of a recording.

    Raises:
        UnreadableFile: A part of the recording cannot be read.
    """
    trial = Trial()
    with Recording(path) as recording:
        for recorded in read_journal(recording, _refuse):
            _take(trial, recorded)
    return trial


def _take(trial: Trial, recorded: RecordedEntry) -> None:
    entry = recorded.entry
    if entry.kind is EntryKind.EFFECT and entry.name == PublishTwist.__name__:
        effect = read_effect(entry)
        if isinstance(effect, PublishTwist):
            twist = effect.twist
            trial.command(TrialCommand(entry.t_ns / NS_PER_S, twist.linear, twist.angular))
    elif entry.kind is EntryKind.EVENT and entry.name in _EVENTS:
        event = read_event(entry)
        if isinstance(event, OdomReceived) and is_finite(event.odometry):
            delay_s = (recorded.log_ns - event.odometry.stamp_ns) / NS_PER_S
            trial.sample(TrialSample(event.t_ns / NS_PER_S, event.odometry.pose, delay_s))
        elif isinstance(event, DriveRequested) and event.course.held is not None:
            trial.begin(event.course.held, event.t_ns / NS_PER_S)


def _refuse(missing: str) -> None:
    raise UnreadableFile(missing)


STEADY_S = 0.8
"""The time before the last command of the wanted speed, in which the full speed is measured [s]."""

STANDS_S = 0.4
"""The time that the base must stand at the end of a motion's odometry [s]."""

MOVES_SHARE = 0.2
"""A base moves if its speed is at least this share of the commanded one."""

NEAR_S = 0.02
"""A base stands once it is nearer to its final position than its full speed times this [s]."""

MIN_SAMPLES = 3

CLOCKS_DIFFER_S = 1.0
"""An odometry delay above this [s], or below zero, counts as the offset between two clocks."""


@dataclass(frozen=True, slots=True)
class Turned:
    """The properties of a turn on the spot, measured by odometry; see `Measured`."""

    commanded_rps: float
    reached_rps: float
    command_delay_s: float
    stopping_rad: float
    stopping_s: float


@dataclass(frozen=True, slots=True)
class Measured:
    """The properties of a base, measured by odometry."""

    odometry_hz: float
    odometry_gap_s: float
    """The longest time between two samples of odometry."""
    odometry_delay_s: float | None
    """The median time from stamp to arrival, None if the clocks of base and daemon differ."""
    clock_offset_s: float
    """The median time from stamp to arrival if the clocks differ, else 0."""
    commanded_mps: float
    reached_mps: float
    command_delay_s: float
    """The time from a command to the measured motion, with all delays and the lag of the base."""
    stopping_m: float
    """The distance from the zero command to the standstill."""
    stopping_s: float
    """The time from the zero command to the standstill."""
    base_timeout_s: float | None
    """The time that the base moves on without a command, None if longer than `quiet_s`."""
    quiet_s: float
    turn: Turned | None
    """None if the base cannot turn on the spot, like a car."""


@dataclass(frozen=True, slots=True)
class _Line:
    """A motion at constant speed [m/s or rad/s]: at time t, the distance is speed * (t - since)."""

    speed: float
    since_s: float

    def at(self, t_s: float) -> float:
        return self.speed * (t_s - self.since_s)


def measured(trial: Trial) -> Measured:
    """Return the properties of a base from two straight motions, then a turn.

    Raises:
        Refused: The trial does not have these three motions or has too few samples; or the base
            did not move, did not stop, or turned in the wrong direction.
    """
    kinds = [(motion.is_turn, motion.held.quiet_s > 0.0) for motion in trial.motions]
    if kinds != [(False, False), (False, True), (True, False)]:
        raise Refused(f"{len(kinds)} motions, and not the three of a commissioning")
    stopped, unheard, turn = trial.motions
    line = _moving_line(stopped)
    stopping_m, stopping_s = _stop(stopped, line)
    gaps_s = [after.t_s - before.t_s for before, after in pairwise(trial.samples)]
    delay_s = median(sample.delay_s for sample in trial.samples)
    differ = not 0.0 <= delay_s <= CLOCKS_DIFFER_S
    return Measured(
        odometry_hz=1.0 / fmean(gaps_s),
        odometry_gap_s=max(gaps_s),
        odometry_delay_s=None if differ else delay_s,
        clock_offset_s=delay_s if differ else 0.0,
        commanded_mps=stopped.held.linear_mps,
        reached_mps=line.speed,
        command_delay_s=_delay_s(stopped, line),
        stopping_m=stopping_m,
        stopping_s=stopping_s,
        base_timeout_s=_timeout_s(unheard, stopping_m),
        quiet_s=unheard.held.quiet_s,
        turn=_turned(turn),
    )


def _turned(motion: Motion) -> Turned | None:
    """Return the properties of a turn, None without one; may raise Refused."""
    line = _line(motion)
    if line.speed <= -MOVES_SHARE * motion.wanted:
        raise Refused(
            f"the base turned at {line.speed:.2f} rad/s where {motion.wanted:g} was commanded",
            "see whether its left and right wheels are swapped",
        )
    if not _moves(motion, line):
        return None
    stopping_rad, stopping_s = _stop(motion, line)
    delay_s = _delay_s(motion, line)
    return Turned(motion.wanted, line.speed, delay_s, stopping_rad, stopping_s)


def _last_s(motion: Motion) -> float:
    """Return the time [s] of the last command with the wanted velocity."""
    return max((t_s for t_s, value in motion.sent() if value == motion.wanted), default=0.0)


def _delay_s(motion: Motion, line: _Line) -> float:
    """Return the lag of the motion behind its commands [s]."""
    return max(line.since_s - _commanded_since_s(motion), 0.0)


def _commanded_since_s(motion: Motion) -> float:
    """Return the start [s] of a motion without a ramp that commands the same distance."""
    last_s = _last_s(motion)
    sent = [(t_s, value) for t_s, value in motion.sent() if t_s <= last_s]
    driven = sum(value * (after_s - t_s) for (t_s, value), (after_s, _) in pairwise(sent))
    return last_s - driven / motion.wanted


def _moving_line(motion: Motion) -> _Line:
    """Return the line of a motion in which the base must move; may raise Refused."""
    line = _line(motion)
    if not _moves(motion, line):
        raise Refused(
            f"the base went on at {line.speed:.3f} m/s where {motion.wanted:g} m/s was commanded",
            "see whether it is switched on, and not below the smallest speed that it can drive",
        )
    return line


def _moves(motion: Motion, line: _Line) -> bool:
    return line.speed >= MOVES_SHARE * motion.wanted


def _line(motion: Motion) -> _Line:
    """Return the line fitted to the last STEADY_S of driving; may raise Refused."""
    last_s = _last_s(motion)
    steady = [(t_s, x) for t_s, x in motion.way() if last_s - STEADY_S <= t_s <= last_s]
    if len(steady) < MIN_SAMPLES:
        raise Refused(f"{len(steady)} samples of odometry in {STEADY_S:g} s are too few to measure")
    fit = linear_regression(*zip(*steady, strict=True))
    return _Line(fit.slope, -fit.intercept / fit.slope if fit.slope else last_s)


def _rest(motion: Motion, from_s: float, until_s: float) -> tuple[float, bool]:
    """Return a period's mean position [m or rad], and whether the base stood; may raise Refused."""
    xs = [x for t_s, x in motion.way() if from_s <= t_s <= until_s]
    if len(xs) < MIN_SAMPLES - 1:
        raise Refused("odometry ended before the base stood")
    limit = MOVES_SHARE * motion.wanted * (until_s - from_s)
    return fmean(xs), max(xs) - min(xs) <= limit


def _stop(motion: Motion, line: _Line) -> tuple[float, float]:
    """Return distance [m, rad] and time [s] from zero command to standstill, or raise Refused."""
    last_s, way = _last_s(motion), motion.way()
    zero_s = min((t_s for t_s, _ in motion.sent() if t_s > last_s), default=last_s)
    end_s = way[-1][0]
    rest, stands = _rest(motion, end_s - STANDS_S, end_s)
    if not stands:
        raise Refused("the base was still moving when the motion was over", "stop it by hand")
    near = NEAR_S * line.speed
    stood_s = max((t_s for t_s, x in way if abs(x - rest) > near), default=zero_s)
    return max(rest - line.at(zero_s), 0.0), max(stood_s - zero_s, 0.0)


def _timeout_s(motion: Motion, stopping_m: float) -> float | None:
    """Return the time [s] that the base drove on without a command, None if it did not stop."""
    last_s, line = _last_s(motion), _moving_line(motion)
    end_s = last_s + motion.held.quiet_s
    rest_m, stands = _rest(motion, end_s - STANDS_S, end_s)
    if not stands:
        return None
    return max(rest_m - line.at(last_s) - stopping_m, 0.0) / line.speed


STEERED_DELAY_S: Final = 0.2
"""The longest delay [s] for which the default gains are proposed."""

STOP_WITHIN_M: Final = 0.3
"""The distance within which the base stops from the proposed speed."""

STOP_WITHIN_RAD: Final = pi / 4.0
"""The angle within which the base stops from the proposed turn rate."""

ODOMETRY_PERIODS: Final = 10
LARGEST_GAPS: Final = 3
MIN_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposed value for a key of the configuration; `why` is the reason."""

    key: str
    value: float
    why: str


def proposals(base: Measured, present: KernelParams) -> list[Proposal]:
    """Return proposed values for the base; limits and gains do not exceed those in `present`."""
    follow_s = base.command_delay_s
    lag_s = _rounded(min(max(follow_s - (base.odometry_delay_s or 0.0), 0.0), 0.5))
    steer_s = max(follow_s, base.turn.command_delay_s if base.turn else 0.0)
    share, steered = _share(follow_s), _share(steer_s)
    gains, defaults = present.tracking, KernelParams().tracking
    period_s = ODOMETRY_PERIODS / base.odometry_hz
    limits, reaction_s = present.limits, base.stopping_m / base.reached_mps
    speed_mps = _stopping_within(STOP_WITHIN_M, reaction_s, limits.linear_accel_mps2)
    timeout_s = max(period_s, LARGEST_GAPS * base.odometry_gap_s, MIN_TIMEOUT_S)
    return [
        Proposal(
            "limits.linear_mps",
            _rounded(max(min(limits.linear_mps, speed_mps), 0.01)),
            f"at most so fast that it stops within {STOP_WITHIN_M:g} m",
        ),
        *_turning(base.turn, present),
        Proposal("tracking.lag_s", lag_s, f"the base follows a command {lag_s:g} s later"),
        Proposal(
            "tracking.k_x", _rounded(min(gains.k_x, defaults.k_x * share)), _allowed_by(follow_s)
        ),
        Proposal(
            "tracking.k_y",
            _rounded(min(gains.k_y, defaults.k_y * steered**2)),
            _allowed_by(steer_s),
        ),
        Proposal(
            "tracking.k_theta",
            _rounded(min(gains.k_theta, defaults.k_theta * steered)),
            _allowed_by(steer_s),
        ),
        Proposal(
            "odometry.timeout_s",
            _rounded(min(timeout_s, 10.0)),
            f"{ODOMETRY_PERIODS} periods, {LARGEST_GAPS} of the largest gaps, "
            f"and {MIN_TIMEOUT_S:g} s at least",
        ),
    ]


def _turning(turn: Turned | None, present: KernelParams) -> list[Proposal]:
    """Return the proposed limit of the turn rate, [] if the base cannot turn on the spot."""
    if turn is None:
        return []
    limits = present.limits
    reaction_s = turn.stopping_rad / turn.reached_rps
    rate = _stopping_within(STOP_WITHIN_RAD, reaction_s, limits.angular_accel_rps2)
    return [
        Proposal(
            "limits.angular_rps",
            _rounded(max(min(limits.angular_rps, rate), 0.01)),
            f"at most so fast that it stops within {degrees(STOP_WITHIN_RAD):.0f} degrees",
        )
    ]


def _share(delay_s: float) -> float:
    return min(1.0, STEERED_DELAY_S / delay_s) if delay_s else 1.0


def _allowed_by(delay_s: float) -> str:
    if _share(delay_s) < 1.0:
        return f"{delay_s:.2f} s of delay allow no more"
    return "that of the default"


def _stopping_within(way: float, reaction_s: float, braking: float) -> float:
    """Return the speed v with a stopping distance v * reaction_s + v^2 / (2 * braking) = way."""
    return braking * (sqrt(reaction_s**2 + 2.0 * way / braking) - reaction_s)


def _rounded(value: float) -> float:
    return round(value, 2)


def measured_lines(base: Measured) -> list[str]:
    """Return a line for each measured property."""
    delay_s, turn, timeout_s = base.odometry_delay_s, base.turn, base.base_timeout_s
    came = "its clock is another" if delay_s is None else f"{delay_s * 1e3:.1f} ms after its stamp"
    ends = f"none within {base.quiet_s:g} s"
    turns = ["turning        not on its place"]
    if timeout_s is not None:
        ends = f"{timeout_s:.2f} s after the last command"
    if turn is not None:
        rates = f"{turn.reached_rps:.3f} rad/s where {turn.commanded_rps:.3f} was commanded"
        turns = [
            f"turning        {rates}",
            f"  delay        {turn.command_delay_s:.2f} s until odometry follows",
            f"  stopping     {turn.stopping_rad:.3f} rad and {turn.stopping_s:.2f} s after a zero",
        ]
    gap_ms = base.odometry_gap_s * 1e3
    return [
        f"odometry       {base.odometry_hz:.1f} Hz, {gap_ms:.0f} ms apart at most, {came}",
        f"speed          {base.reached_mps:.3f} m/s where {base.commanded_mps:.3f} was commanded",
        f"command delay  {base.command_delay_s:.2f} s until odometry follows",
        f"stopping       {base.stopping_m:.3f} m and {base.stopping_s:.2f} s after a zero",
        f"base timeout   {ends}",
        *turns,
    ]


def warnings(base: Measured) -> Iterator[str]:
    """Yield a sentence for each property that is dangerous, or makes a measured value doubtful."""
    if base.base_timeout_s is None:
        yield (
            f"the base went on for {base.quiet_s:g} s without a command: if robotctl is killed, "
            "only its own emergency stop stops it"
        )
    if base.odometry_delay_s is None:
        yield (
            f"odometry is stamped by a clock that differs by {base.clock_offset_s:.1f} s: "
            "its delay is unknown, and part of the command delay"
        )
    share = base.reached_mps / base.commanded_mps
    if abs(share - 1.0) > SPEED_TOLERANCE:
        yield f"the base drove {share:.0%} of the commanded speed: see its wheel parameters"
    if base.turn is None:
        yield (
            "the base did not turn on its place: limits.angular_rps is as it was, and patterns "
            "with corners need a base that can"
        )
    elif abs(base.turn.reached_rps / base.turn.commanded_rps - 1.0) > SPEED_TOLERANCE:
        share = base.turn.reached_rps / base.turn.commanded_rps
        yield f"the base turned at {share:.0%} of the commanded rate: see its wheel separation"


SPEED_TOLERANCE = 0.1


def file_lines(
    robot: str, base: Measured, settings: Mapping[str, object], proposed: list[Proposal]
) -> Iterator[str]:
    """Yield the lines of a configuration file, with the measured values as comments."""
    yield f"# Proposed by robotctl commission for robot {robot}, from motions at"
    yield f"# {base.commanded_mps:g} m/s. Read it before you use it."
    yield "#"
    for line in (*measured_lines(base), *(f"warning: {text}" for text in warnings(base))):
        yield f"# {line}"
    yield ""
    for each in proposed:
        yield f"{each.key}: {each.value:g}  # {each.why}"
    keys = {each.key for each in proposed}
    for key, value in settings.items():
        if key not in keys:
            yield f"{key}: {json.dumps(value)}"
