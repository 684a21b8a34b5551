"""The motions of a commissioning, as their recording holds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.course import Held
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.types import DriveRequested, OdomReceived, PublishTwist
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.read.journal_reader import RecordedEntry, read_journal
from robotctl.rerun.journal_values import read_effect, read_event

_EVENTS = (OdomReceived.__name__, DriveRequested.__name__)


class TrialSample(NamedTuple):
    """A sample of odometry: its arrival (steady), and how long after its stamp it arrived."""

    t_s: float
    pose: Pose
    delay_s: float


class TrialCommand(NamedTuple):
    """A command that was sent, at a steady time."""

    t_s: float
    linear_mps: float
    angular_rps: float


@dataclass(slots=True)
class Motion:
    """What was asked for, and all commands and odometry until the next motion was."""

    held: Held
    begin_s: float
    commands: list[TrialCommand] = field(default_factory=list)
    samples: list[TrialSample] = field(default_factory=list)

    @property
    def is_turn(self) -> bool:
        """Whether the robot was to turn on its place."""
        return self.held.linear_mps == 0.0

    @property
    def wanted(self) -> float:
        """The velocity that was asked for [m/s], of a turn its rate [rad/s]."""
        return self.held.angular_rps if self.is_turn else self.held.linear_mps

    def sent(self) -> list[tuple[float, float]]:
        """Return time and velocity of each command, as `wanted` is one."""
        return [(c.t_s, c.angular_rps if self.is_turn else c.linear_mps) for c in self.commands]

    def way(self) -> list[tuple[float, float]]:
        """Return time and distance forward, of a turn the angle, of each sample from the first."""
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
    """The odometry of a whole recording, and its motions of a held velocity."""

    samples: list[TrialSample] = field(default_factory=list)
    motions: list[Motion] = field(default_factory=list)

    def begin(self, held: Held, t_s: float) -> None:
        """Take the request for the next motion; the robot stands, as the last sample told."""
        self.motions.append(Motion(held, t_s, samples=self.samples[-1:]))

    def sample(self, sample: TrialSample) -> None:
        """Take a sample of odometry."""
        self.samples.append(sample)
        if self.motions:
            self.motions[-1].samples.append(sample)

    def command(self, command: TrialCommand) -> None:
        """Take a command that was sent."""
        if self.motions:
            self.motions[-1].commands.append(command)


def read_trial(path: Path) -> Trial:
    """Return what a recording tells.

    Raises:
        UnreadableFile: A part of it cannot be read.
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
