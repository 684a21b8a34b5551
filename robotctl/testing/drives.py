"""Makes recordings of simulated drives, like those of a daemon, without a daemon or waiting."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from robotctl import __version__
from robotctl.base.errors import UnreadableFile
from robotctl.check.closed_loop import closed_loop
from robotctl.check.journal import read_effect
from robotctl.config import Config, flat
from robotctl.daemon.control.dispatcher import Journal
from robotctl.kernel import constants
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveRequested,
    Effect,
    Event,
    FaultReported,
    LoopStalled,
    PublishTwist,
    Twist,
)
from robotctl.messages import cdr
from robotctl.messages.inputs import encode_twist
from robotctl.messages.installed import installed_type
from robotctl.recording import Recorder, RecorderOptions, Topic
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode, encode
from robotctl.recording.format.names import PARAMETER_PREFIX
from robotctl.recording.format.noted_events import noted_event
from robotctl.recording.format.recorded_events import RecordedEvent

START_NS = 1_700_000_000_000_000_000
"""Log times [ns since the epoch] are the steady times of the journal plus this."""

GID = b"publisher-number"
"""The gid of the publisher of all recorded messages."""

QOS = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


def installed_topic(name: str, type_name: str) -> Topic:
    """Return the topic `name` of type `type_name`, with the type's installed definition."""
    text, type_hash = installed_type(type_name)
    return Topic(name, type_name, text, type_hash, QOS)


TWIST = installed_topic("/cmd_vel", constants.TWIST)
ODOMETRY = installed_topic("/odom", cdr.ODOMETRY)

BEGIN_NS = 5_000_000_000
"""The steady time at which drives begin [ns]."""

Step = tuple[Event, tuple[Effect, ...]]
"""An event and the effects that the kernel decided on."""

JOURNAL = installed_topic("/robotctl/journal", cdr.JOURNAL_ENTRY)

MAX_QUEUED = 20_000
"""The number of queued messages above which `record` waits."""

Written = JournalEntry | Twist | bytes
"""One item to record: a journal entry, a published command, or serialized odometry."""


def drive_requested(after_s: float = 0.1, laps: int = 0) -> DriveRequested:
    """Return a request to drive a square, `after_s` seconds after BEGIN_NS."""
    t_ns = BEGIN_NS + round(after_s * NS_PER_S)
    return DriveRequested(t_ns, 1, Pattern(), laps, False, "operator")


def drive(
    seconds: float = 3.0,
    *,
    config: Config | None = None,
    requests: Sequence[Event] | None = None,
    snapshots_s: Iterable[float] = (0.0,),
    then: Iterable[Event] = (),
    closed: bool = True,
) -> list[Written]:
    """Return the journal entries and commands that a daemon writes in a drive of `seconds`.

    The robot is simulated. `requests` are events given to the kernel at the start, by default one
    request to drive a square. `then` are events given to it at the end. If `closed` is False, the
    final snapshot of the kernel's state is missing, as if the daemon had been killed.
    """
    config = config or Config()
    asked = [drive_requested()] if requests is None else requests
    kernel = Kernel(config.kernel)
    snapshots_ns = [BEGIN_NS + round(after_s * NS_PER_S) for after_s in snapshots_s]
    written = list(journaled(kernel, _steps(kernel, config, asked, seconds, then), snapshots_ns))
    return written if closed else written[:-1]


def journaled(
    kernel: Kernel, steps: Iterable[Step], snapshots_ns: Iterable[int] = (BEGIN_NS,)
) -> Iterator[Written]:
    """Yield the journal entries and commands that a daemon writes for `steps` of a kernel.

    Snapshots of the kernel's state are written at the times `snapshots_ns`. The last entries are
    the event of the daemon's end (a fault with cause DAEMON_ENDS) and a final snapshot.
    """
    written: list[Written] = []
    commands = 0
    journal = Journal(lambda serialized, seq: written.append(decode(serialized)), lambda: commands)
    due_ns, t_ns = deque(snapshots_ns), BEGIN_NS
    if due_ns and due_ns[0] == BEGIN_NS:
        journal.snapshot(due_ns.popleft(), kernel)
    for event, effects in steps:
        t_ns = event.t_ns
        journal.add(event.t_ns, EntryKind.EVENT, event)
        if isinstance(event, LoopStalled):
            written.extend([ZERO] * event.zeros)
            commands += event.zeros
        for effect in effects:
            if isinstance(effect, PublishTwist):
                written.append(effect.twist)
                commands += 1
            journal.add(event.t_ns, EntryKind.EFFECT, effect)
        if due_ns and event.t_ns >= due_ns[0]:
            journal.snapshot(due_ns.popleft(), kernel)
        yield from written
        written.clear()
    ending = FaultReported(t_ns, Cause.DAEMON_ENDS, "the daemon is stopping")
    journal.add(ending.t_ns, EntryKind.EVENT, ending)
    kernel.step(ending)
    journal.snapshot(t_ns, kernel)
    yield from written


def _steps(
    kernel: Kernel, config: Config, asked: Iterable[Event], seconds: float, then: Iterable[Event]
) -> Iterator[Step]:
    end_ns = BEGIN_NS + round(seconds * NS_PER_S)
    for event, effects in closed_loop(kernel, config.sim, asked, BEGIN_NS):
        yield event, effects
        if event.t_ns >= end_ns:
            break
    for event in then:
        yield event, kernel.step(event)


def record(
    folder: Path,
    written: Iterable[Written],
    *,
    config: Config | None = None,
    robot: str = "robot",
    version: str = __version__,
    options: RecorderOptions | None = None,
    clock: Callable[[int], int] = lambda time_ns: time_ns,
    beside: Callable[[Recorder, int], None] = lambda recorder, time_ns: None,
) -> Path:
    """Make a recording of the items `written` in `folder`, and return the folder.

    Log times follow the journal; `clock` converts them to wall-clock times. Before each item,
    `beside(recorder, time_ns)` is called, and may record further messages.
    """
    parameters = {f"{PARAMETER_PREFIX}{key}": str(v) for key, v in flat(config or Config()).items()}
    recorder = Recorder(
        folder,
        options or RecorderOptions(chunk_bytes=1 << 14),
        metadata=lambda: {"robotctl": version, "robot": robot, **parameters},
        on_failure=_fail,
    )
    journal, commands = recorder.add_topic(JOURNAL), recorder.add_topic(TWIST)
    odometry = recorder.add_topic(ODOMETRY)
    time_ns, published = START_NS, 0
    for number, each in enumerate(written, 1):
        beside(recorder, clock(time_ns))
        if isinstance(each, JournalEntry):
            time_ns = max(time_ns, START_NS + each.t_ns)
            now_ns = clock(time_ns)
            recorder.write(journal, encode(each), now_ns, now_ns, each.seq + 1, GID)
            if (event := _noted_event(each, now_ns)) is not None:
                recorder.add_event(event)
        elif isinstance(each, Twist):
            published += 1
            now_ns = clock(time_ns)
            recorder.write(commands, encode_twist(each), now_ns + 9, now_ns + 1, published, GID)
        else:
            recorder.write(odometry, each, clock(time_ns), clock(time_ns), 0, GID)
        time_ns += 10
        while number % MAX_QUEUED == 0 and recorder.stats().queued > MAX_QUEUED:
            time.sleep(0.001)
    recorder.close()
    return folder


def _noted_event(entry: JournalEntry, now_ns: int) -> RecordedEvent | None:
    """Return the event that a daemon records with this journal entry, or None."""
    if entry.kind is not EntryKind.EFFECT:
        return None
    try:
        return noted_event(read_effect(entry), now_ns)
    except UnreadableFile:  # a test changed the entry
        return None


def _fail(detail: str) -> None:
    raise AssertionError(detail)
