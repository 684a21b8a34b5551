"""A check finds different decisions and broken invariants, and names what it could not read."""

from __future__ import annotations

import os
import shutil
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotctl import __version__
from robotctl.base.errors import UnreadableFile
from robotctl.check.closed_loop import resimulate
from robotctl.check.incident import find_incident
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.check.what_if import what_if
from robotctl.check.why import explain
from robotctl.kernel import drive as drive_module
from robotctl.kernel import kernel as kernel_module
from robotctl.kernel.geometry import Pose
from robotctl.kernel.params import TrackingParams, VelocityLimits
from robotctl.kernel.tracking import Reference, track
from robotctl.kernel.types import CommandPublishersSeen, ModeRequested, Twist
from robotctl.messages.inputs import encode_twist
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry, encode
from robotctl.testing.drives import (
    BEGIN_NS,
    GID,
    JOURNAL,
    START_NS,
    TWIST,
    drive,
    drive_requested,
    record,
)
from tests.support.checked_drives import checked, drive_of_3_s, entries_of, from_snapshot
from tests.support.recordings import Tape, flip
from tests.support.waiting import until


def test_the_same_kernel_decides_the_same(tmp_path: Path) -> None:
    report = checked(tmp_path, drive_of_3_s())
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert report.bitwise
    journal = entries_of(drive_of_3_s())
    assert report.events == sum(entry.kind is EntryKind.EVENT for entry in journal)
    assert report.effects == sum(entry.kind is EntryKind.EFFECT for entry in journal)
    assert report.commands == len(drive_of_3_s()) - len(journal)
    assert report.duration_s == pytest.approx(3.0, abs=0.1)


def test_a_kernel_with_another_gain_diverges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stronger(
        reference: Reference, pose: Pose, gains: TrackingParams, limits: VelocityLimits
    ) -> Twist:
        return track(reference, pose, replace(gains, k_x=gains.k_x * 1.001), limits)

    monkeypatch.setattr(drive_module, "track", stronger)
    report = checked(tmp_path, drive_of_3_s())
    assert report.verdict is Verdict.DIVERGED
    assert report.divergence is not None
    assert report.divergence.event.startswith("Tick ")
    assert report.divergence.recorded.startswith("PublishTwist ")
    assert "twist.linear: recorded " in report.divergence.differences[0]


def test_a_recording_without_a_journal_is_not_called_the_same(tmp_path: Path) -> None:
    report = checked(tmp_path, [Twist(), Twist()])
    assert report.verdict is Verdict.INCOMPLETE
    assert "holds no snapshot" in report.missing[0]


def test_what_a_gap_leaves_is_checked_and_the_gap_is_named(tmp_path: Path) -> None:
    position = 40
    report = checked(tmp_path, drive_of_3_s()[:position] + drive_of_3_s()[position + 3 :])
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing[0].startswith("the journal lacks")


def tape(folder: Path, **options: Any) -> Tape:
    return Tape(folder, metadata=lambda: {"robotctl": __version__}, **options)


def test_every_file_of_a_recording_can_be_checked_alone(tmp_path: Path) -> None:
    written = drive(4.0, snapshots_s=(0.0, 2.0))
    folder = tmp_path / "run"
    recorder = tape(folder)
    journal, commands = recorder.add_topic(JOURNAL), recorder.add_topic(TWIST)
    sent = 0
    for number, each in enumerate(written):
        log_ns = START_NS + number * 1_000_000
        if isinstance(each, JournalEntry):
            if each.kind is EntryKind.SNAPSHOT and 0 < number < len(written) - 1:
                recorder.split()
                until(lambda: recorder.begun)
            recorder.write(journal, encode(each), log_ns, log_ns, each.seq + 1, GID)
        elif isinstance(each, Twist):
            sent += 1
            recorder.write(commands, encode_twist(each), log_ns + 9, log_ns + 1, sent, GID)
    recorder.close()
    reports = [check_recording(path) for path in (folder, *sorted(folder.glob("*.mcap")))]
    assert [report.verdict for report in reports] == [Verdict.SAME] * 3
    assert reports[0].events == reports[1].events + reports[2].events


def test_a_recording_that_goes_on_is_checked_as_far_as_it_is(tmp_path: Path) -> None:
    recorder = tape(tmp_path / "run", flush_s=0.01)
    journal, commands = recorder.add_topic(JOURNAL), recorder.add_topic(TWIST)
    entries = entries_of(drive_of_3_s())
    while entries.pop().kind is not EntryKind.EFFECT:
        pass  # the effect of the last tick is still to come
    for each in entries:
        recorder.write(journal, encode(each), START_NS, START_NS, each.seq + 1, GID)
    sent = [each for each in drive_of_3_s() if isinstance(each, Twist)]
    for number, twist in enumerate(sent, 1):
        recorder.write(commands, encode_twist(twist), START_NS, START_NS, number, GID)
    recorder.settle()
    report = check_recording(tmp_path / "run")
    recorder.close()
    assert report.verdict is Verdict.SAME
    assert report.events == sum(entry.kind is EntryKind.EVENT for entry in entries)
    assert "it has no loss ledger" in report.notes[0]


@pytest.mark.parametrize("damage", ["cut", "hole"])
def test_a_damaged_file_is_never_called_the_same(tmp_path: Path, damage: str) -> None:
    (file,) = record(tmp_path / "run", drive_of_3_s()).glob("*.mcap")
    if damage == "cut":
        os.truncate(file, file.stat().st_size // 2)
    else:
        with Recording(file) as recording:
            chunk = recording._files[0].index.places[3]
        flip(file, chunk.offset + chunk.length // 2)
    report = check_recording(file)
    assert report.verdict is Verdict.INCOMPLETE
    assert report.events > 10
    assert report.missing


def test_the_commands_of_another_node_are_told_and_not_held_against_us(tmp_path: Path) -> None:
    seen = CommandPublishersSeen(BEGIN_NS + 10_000_000, ("/teleop",))
    written = drive(1.0, requests=[seen])
    report = checked(tmp_path, [*written, Twist(0.7, 0.1)])
    assert report.verdict is Verdict.SAME
    assert report.notes == [
        "1 commands without a decision, such as 0.7 m/s, 0.1 rad/s: /teleop published as well"
    ]


def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    def peak_of(seconds: float) -> int:
        folder = record(tmp_path / f"{seconds}", drive(seconds))
        tracemalloc.start()
        try:
            assert check_recording(folder).verdict is Verdict.SAME
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    short, long = peak_of(2.0), peak_of(20.0)
    assert long < short + 1_000_000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"rate_hz":50.0', '"rate_hz":0.0'),
        ('"rate_hz":50.0', '"rate_hz":-1'),
        ('"linear_mps":0.6', '"linear_mps":"nan"'),
        ('"size_m":1.0', '"size_m":"inf"'),
        ('"segment":0', '"segment":99'),
        ('"kind":"square"', '"kind":"spiral"'),
        ('"command":{"linear":', '"command":{"linear":9'),
        ('"tick_t_ns":', '"tick_t_ns":-'),
    ],
)
def test_an_impossible_snapshot_is_reported_by_every_command(
    tmp_path: Path, old: str, new: str
) -> None:
    stop = ModeRequested(BEGIN_NS + 1_500_000_000, 2, 3, "operator")
    written = drive(2.0, requests=[drive_requested(), stop], snapshots_s=(1.0,))
    snapshot, *rest = from_snapshot(written, 0)
    assert isinstance(snapshot, JournalEntry)
    assert old in snapshot.data
    changed = snapshot._replace(data=snapshot.data.replace(old, new))
    folder = record(tmp_path / "run", [changed, *rest])
    assert check_recording(folder).verdict is not Verdict.SAME
    for look in (
        lambda: what_if(folder, {"tracking.k_y": "8"}),
        lambda: resimulate(folder, {}),
        lambda: told_why(folder),
    ):
        with suppress(UnreadableFile):
            look()


def told_why(folder: Path) -> None:
    """Explain the last incident, if there is one."""
    incident = find_incident(folder).incident
    if incident is not None:
        explain(incident)


@pytest.mark.parametrize("robot", ["robot", "r2"])
def test_a_file_of_another_recording_is_named_and_checked_on_its_own(
    tmp_path: Path, robot: str
) -> None:
    folder = record(tmp_path / "run", drive_of_3_s())
    (other,) = record(tmp_path / "other", drive(1.0), robot=robot).glob("*.mcap")
    shutil.copy(other, folder)
    report = check_recording(folder)
    assert report.verdict is Verdict.INCOMPLETE
    assert (
        f"{other.name} is of another recording, of robot {robot}: checked on its own, it is same"
        in report.missing
    )
    assert report.events == check_recording(folder / "run_0.mcap").events


def test_a_command_that_was_published_and_not_decided_is_found(tmp_path: Path) -> None:
    report = checked(tmp_path, [*drive_of_3_s(), Twist(0.3, 0.0)])
    assert report.verdict is Verdict.BROKEN
    assert "1 commands without a decision, such as 0.3 m/s" in report.violations[0].text


def test_a_kernel_that_fails_in_itself_diverges(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_module, "within", lambda command, limits: command.linear < 0.1)
    report = checked(tmp_path, drive_of_3_s())
    assert report.divergence is not None
    assert report.divergence.decided.startswith("AssertionError")
