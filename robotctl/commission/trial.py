"""The motions of a commissioning, as their recording holds them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from robotctl.errors import UnreadableFile
from robotctl.kernel.course import Held
from robotctl.kernel.geometry import Pose
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.types import DriveRequested, OdomReceived, PublishTwist
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.read.journal_reader import RecordedEntry, read_journal
from robotctl.rerun.journal_values import read_effect, read_event

_EVENTS = (OdomReceived.__name__, DriveRequested.__name__)


class Sample(NamedTuple):
    """A sample of odometry: its arrival (steady), and how long after its stamp it arrived."""

    t_s: float
    pose: Pose
    delay_s: float


class Command(NamedTuple):
    """A command that was sent, at a steady time."""

    t_s: float
    linear_mps: float


@dataclass(slots=True)
class Motion:
    """What was asked for, and all commands and odometry until the next motion was."""

    held: Held
    begin_s: float
    commands: list[Command] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)


@dataclass(slots=True)
class Trial:
    """The odometry of a whole recording, and its motions of a held velocity."""

    samples: list[Sample] = field(default_factory=list)
    motions: list[Motion] = field(default_factory=list)

    def begin(self, held: Held, t_s: float) -> None:
        """Take the request for the next motion; the robot stands, as the last sample told."""
        self.motions.append(Motion(held, t_s, samples=self.samples[-1:]))

    def sample(self, sample: Sample) -> None:
        """Take a sample of odometry."""
        self.samples.append(sample)
        if self.motions:
            self.motions[-1].samples.append(sample)

    def command(self, command: Command) -> None:
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
            trial.command(Command(entry.t_ns / NS_PER_S, effect.twist.linear))
    elif entry.kind is EntryKind.EVENT and entry.name in _EVENTS:
        event = read_event(entry)
        if isinstance(event, OdomReceived) and is_finite(event.odometry):
            delay_s = (recorded.log_ns - event.odometry.stamp_ns) / NS_PER_S
            trial.sample(Sample(event.t_ns / NS_PER_S, event.odometry.pose, delay_s))
        elif isinstance(event, DriveRequested) and event.course.held is not None:
            trial.begin(event.course.held, event.t_ns / NS_PER_S)


def _refuse(missing: str) -> None:
    raise UnreadableFile(missing)
