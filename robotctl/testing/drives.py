"""Recordings of simulated drives as the daemon makes them, without a daemon or any waiting."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

from robotctl import __version__
from robotctl.config import Config, flat
from robotctl.daemon.journal import Journal
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import DriveRequested, Effect, Event, PublishTwist, Twist
from robotctl.recording.journal import TYPE_NAME, JournalEntry, decode, encode
from robotctl.recording.recorder import Recorder, RecorderOptions, Topic
from robotctl.replay.closed_loop import closed_loop
from robotctl.testing.recordings import GID, START_NS, TWIST

BEGIN_NS = 5_000_000_000
"""Steady time at which drives begin."""

JOURNAL = Topic("/robotctl/journal", TYPE_NAME)

Written = JournalEntry | Twist
"""What a recording is made of: journal entries, and commands as they were published."""


def drive_requested(after_s: float = 0.1, laps: int = 0) -> DriveRequested:
    """A request to drive a square."""
    t_ns = BEGIN_NS + round(after_s * 1e9)
    return DriveRequested(t_ns, 1, Pattern(), laps, False, "somebody")


def drive(
    seconds: float = 3.0,
    *,
    config: Config | None = None,
    requests: Sequence[Event] | None = None,
    snapshots_s: Iterable[float] = (0.0,),
    then: Iterable[Event] = (),
) -> list[Written]:
    """What a daemon writes and publishes while the simulated robot drives.

    `requests` may be any events; those in `then` come when the robot is gone.
    """
    config = config or Config()
    kernel = Kernel(config.kernel)
    written: list[Written] = []
    journal = Journal(lambda serialized, seq: written.append(decode(serialized)))
    snapshots_ns = [BEGIN_NS + round(after_s * 1e9) for after_s in snapshots_s]
    asked = [drive_requested()] if requests is None else requests
    end_ns = BEGIN_NS + round(seconds * 1e9)

    def steps() -> Iterator[tuple[Event, tuple[Effect, ...]]]:
        for event, effects in closed_loop(kernel, config.sim, asked, BEGIN_NS):
            yield event, effects
            if event.t_ns >= end_ns:
                return

    if snapshots_ns[:1] == [BEGIN_NS]:
        journal.snapshot(snapshots_ns.pop(0), kernel)
    for event, effects in chain(steps(), ((event, kernel.step(event)) for event in then)):
        journal.event(event)
        for effect in effects:
            if isinstance(effect, PublishTwist):
                written.append(effect.twist)
            journal.effect(event.t_ns, effect)
        if snapshots_ns and event.t_ns >= snapshots_ns[0]:
            journal.snapshot(snapshots_ns.pop(0), kernel)
    return written


def record(
    folder: Path,
    written: Iterable[Written],
    *,
    config: Config | None = None,
    robot: str = "robot",
    version: str = __version__,
) -> Path:
    """Make a recording in `folder`; times follow those of the journal."""
    parameters = {f"parameter.{key}": str(v) for key, v in flat(config or Config()).items()}
    recorder = Recorder(
        folder,
        RecorderOptions(chunk_bytes=1 << 14),
        metadata=lambda: {"robotctl": version, "robot": robot, **parameters},
        on_failure=_fail,
    )
    journal, commands = recorder.add_topic(JOURNAL), recorder.add_topic(TWIST)
    log_ns, published = START_NS, 0
    for each in written:
        if isinstance(each, JournalEntry):
            log_ns = max(log_ns, START_NS + each.t_ns)
            recorder.write(journal, encode(each), log_ns, log_ns, each.seq + 1, GID)
        else:
            published += 1
            recorder.write(commands, serialized(each), log_ns + 9, log_ns + 1, published, GID)
        log_ns += 10
    recorder.close()
    return folder


def serialized(twist: Twist) -> bytes:
    """A geometry_msgs/Twist in CDR."""
    return struct.pack("<4s6d", b"\x00\x01\x00\x00", twist.linear, 0, 0, 0, 0, twist.angular)


def _fail(detail: str) -> None:
    raise AssertionError(detail)
