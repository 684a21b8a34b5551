"""Journals of simulated drives, which a test changes, records and checks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

from robotctl import __version__
from robotctl.base.pool import local_threads
from robotctl.check.report import Report
from robotctl.check.run import check_recording
from robotctl.collection.gate import Baseline, GateReport, judge_all
from robotctl.collection.judging import ResultStore, judge_here
from robotctl.config import Config
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import PLAIN, Course, Held
from robotctl.kernel.fence import FenceParams
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    BatteryReceived,
    DriveRequested,
    Event,
    LeaseLost,
    LeaseRequested,
    LoopStalled,
    ModeRequested,
    Odometry,
    OdomReceived,
    ParameterRequested,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.recording.keep.listing import recordings_in
from robotctl.testing.drives import BEGIN_NS, Written, drive, record


@cache
def drive_of_3_s() -> list[Written]:
    """Return the drive that most tests of checks copy and change; do not change it in place."""
    return drive(3.0, snapshots_s=(0.0, 1.5))


def entries_of(written: list[Written]) -> list[JournalEntry]:
    """Return the journal entries of a drive."""
    return [each for each in written if isinstance(each, JournalEntry)]


def from_snapshot(written: list[Written], number: int) -> list[Written]:
    """Return a drive from its snapshot `number` (from 0) on, as if in a later file."""
    snapshots = [
        at
        for at, each in enumerate(written)
        if isinstance(each, JournalEntry) and each.kind is EntryKind.SNAPSHOT
    ]
    return written[snapshots[number] :]


def with_entries(
    written: list[Written], change: Callable[[JournalEntry], JournalEntry]
) -> list[Written]:
    """Return a drive with each journal entry changed, and with the CRCs of the new entries."""
    return rechained([change(each) if isinstance(each, JournalEntry) else each for each in written])


def with_snapshots(written: list[Written], old: str, new: str) -> list[Written]:
    """Return a drive with `new` in place of the first `old` in each snapshot."""

    def change(entry: JournalEntry) -> JournalEntry:
        is_snapshot = entry.kind is EntryKind.SNAPSHOT
        return entry._replace(data=entry.data.replace(old, new, 1)) if is_snapshot else entry

    return with_entries(written, change)


def checked(folder: Path, written: list[Written], version: str = __version__) -> Report:
    return check_recording(record(folder / "run", written, version=version))


def rechained(written: list[Written]) -> list[Written]:
    """Return the journal with the CRC of each snapshot computed again."""
    again: list[Written] = []
    crc: int | None = None
    for each in written:
        entry = each
        if isinstance(entry, JournalEntry):
            if entry.kind is EntryKind.SNAPSHOT:
                crc = _proof_of(entry) if crc is None else crc
                text = re.sub(r'"journal_crc":[0-9]+', f'"journal_crc":{crc}', entry.data)
                entry = entry._replace(data=text)
            crc = None if crc is None else chained(encode(entry), crc)
        again.append(entry)
    return again


def _proof_of(snapshot: JournalEntry) -> int | None:
    found = re.search(r'"journal_crc":([0-9]+)', snapshot.data)
    return int(found[1]) if found else None


def altered(written: list[Written], name: str, old: str, new: str) -> tuple[list[Written], int]:
    """Return the journal, and the number of its last entry `name` with `old`, which gets `new`."""
    changed = list(written)
    for position in range(len(changed) - 1, -1, -1):
        each = changed[position]
        if isinstance(each, JournalEntry) and each.name == name and old in each.data:
            changed[position] = each._replace(data=each.data.replace(old, new, 1))
            return rechained(changed), each.seq
    raise AssertionError(f"no {name} holds {old}")


RESULTS = ".gate"

here = partial(judge_here, processes=local_threads)
"""The engine for `judge_all` that judges in threads of this process."""


def judged(
    folder: Path, baseline: Baseline | None = None, settings: Mapping[str, str] | None = None
) -> GateReport:
    """Judge all recordings of a folder, and store the results in it."""
    store = ResultStore(folder / RESULTS)
    return judge_all(recordings_in(folder), store, settings or {}, baseline or Baseline(), here)


def wrong(written: list[Written], to: str = "0.0") -> list[Written]:
    """Return a drive with another last command, from which a check differs."""
    return altered(written, "PublishTwist", '"linear":0.', f'"linear":{to}')[0]


SQUARE = Pattern()
CIRCLE = Pattern(PatternKind.CIRCLE, 0.3)


def make_history(folder: Path) -> list[Path]:
    """Record each drive of `_histories` below a folder; return the recordings."""
    return [
        record(folder / name, written, config=FENCED if name == "fence" else None)
        for name, written in _histories().items()
    ]


FENCED = Config(kernel=KernelParams(fence=FenceParams(radius_m=0.4)))


def _at(after_s: float) -> int:
    return BEGIN_NS + round(after_s * NS_PER_S)


def _go(
    after_s: float,
    request_id: int,
    pattern: Pattern = SQUARE,
    laps: int = 0,
    *,
    replace: bool = False,
    client: int = 0,
    course: Course = PLAIN,
) -> DriveRequested:
    return DriveRequested(
        _at(after_s), request_id, pattern, laps, replace, "operator", client, course=course
    )


def _mode(after_s: float, request_id: int, mode: Mode) -> ModeRequested:
    return ModeRequested(_at(after_s), request_id, mode, "operator")


def _reset(after_s: float, request_id: int) -> ResetRequested:
    return ResetRequested(_at(after_s), request_id, "operator")


def _histories() -> dict[str, list[Written]]:
    jumped = Odometry(Pose(3.0, 0.0, 0.0), Twist(), _at(0.805))
    hangs = Odometry(Pose(0.2, 0.0, 0.0), Twist(0.3), _at(1.0))
    stops: list[Event] = [
        _go(0.1, 1),
        _mode(1.2, 2, Mode.IDLE),
        _mode(1.3, 3, Mode.MOVING),
        _mode(2.0, 4, Mode.MOVING),
        _mode(2.8, 5, Mode.EMERGENCY_STOP),
        _mode(2.9, 6, Mode.MOVING),
        _reset(3.0, 7),
        _mode(3.1, 8, Mode.ERROR),
        _reset(3.2, 9),
    ]
    still: list[Event] = []
    for number in range(35):
        still.append(OdomReceived(_at(1.0 + 0.02 * number), hangs))
        still.append(Tick(_at(1.001 + 0.02 * number)))
    silent: list[Event] = [Tick(_at(1.5 + 0.02 * number)) for number in range(40)]
    replaced: list[Event] = [
        _go(0.1, 1),
        _go(0.9, 2, CIRCLE),
        _go(1.0, 3, CIRCLE, replace=True),
        _go(1.8, 4, replace=True, course=Course(held=Held(0.2, 0.3, 0.4))),
        _go(3.2, 5, Pattern(PatternKind.LINE, 0.3), 1, course=Course(reverse=True)),
    ]
    lease: list[Event] = [
        LeaseRequested(_at(0.05), 1, take=True, client=7, source="joystick"),
        _go(0.1, 2),
        _go(0.15, 3, client=7),
        ParameterRequested(_at(0.5), 4, "odometry.timeout_s", "0.5", "0.6", "operator"),
        ParameterRequested(_at(0.6), 5, "limits.linear_mps", "0.6", "0.3", "operator"),
        LeaseLost(_at(0.9), 7),
    ]
    laps = [_go(0.1, 1, Pattern(size_m=0.3), 1), _go(10.0, 2, CIRCLE, 2)]
    eight = [_go(0.1, 1, Pattern(PatternKind.FIGURE_EIGHT, 0.4), 1)]
    battery: list[Event] = [_go(0.1, 1), BatteryReceived(_at(0.8), 0.15), _reset(0.9, 2)]
    jump: list[Event] = [_go(0.1, 1), OdomReceived(_at(0.805), jumped)]
    stall: list[Event] = [_go(0.1, 1), LoopStalled(_at(0.9), 0.1, 2, 0, "the disk")]
    return {
        "laps": drive(15.0, requests=laps),
        "eight": drive(5.0, requests=eight),
        "stops": drive(3.4, requests=stops),
        "battery": drive(0.95, requests=battery),
        "odometry": drive(1.48, requests=jump, then=[*silent, _reset(2.5, 2)]),
        "hanging_odometry": drive(0.98, requests=[_go(0.1, 1)], then=still),
        "replaced": drive(5.0, requests=replaced),
        "lease": drive(1.6, requests=lease),
        "fence": drive(2.4, config=FENCED, requests=[_go(0.1, 1)]),
        "stall": drive(1.6, requests=stall),
    }
