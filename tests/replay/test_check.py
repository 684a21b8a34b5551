"""Recordings are checked: the same decisions, every promise kept, and nothing passed over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.kernel import kernel as kernel_module
from robotctl.kernel.types import Twist
from robotctl.recording.journal import JournalEntry, Kind
from robotctl.replay.check import check
from robotctl.replay.report import Report, Verdict
from robotctl.testing.drives import Written, drive, record


@pytest.fixture(scope="module")
def drive_of_3_s() -> list[Written]:
    return drive(3.0, snapshots_s=(0.0, 1.5))


def checked(folder: Path, written: list[Written], **facts: str) -> Report:
    return check(record(folder / "run", written, **facts))


def altered(written: list[Written], name: str, old: str, new: str) -> tuple[list[Written], int]:
    """The last entry of that name changed, and its number."""
    changed = list(written)
    for position in range(len(changed) - 1, -1, -1):
        each = changed[position]
        if isinstance(each, JournalEntry) and each.name == name and old in each.data:
            changed[position] = each._replace(data=each.data.replace(old, new, 1))
            return changed, each.seq
    raise AssertionError(f"no {name} holds {old}")


def test_the_same_kernel_decides_the_same(tmp_path: Path, drive_of_3_s: list[Written]) -> None:
    report = checked(tmp_path, drive_of_3_s)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert report.bitwise
    journal = [each for each in drive_of_3_s if isinstance(each, JournalEntry)]
    assert report.events == sum(entry.kind is Kind.EVENT for entry in journal)
    assert report.effects == sum(entry.kind is Kind.EFFECT for entry in journal)
    assert report.commands == len(drive_of_3_s) - len(journal)
    assert report.duration_s == pytest.approx(3.0, abs=0.1)


def test_a_kernel_with_another_gain_diverges(
    tmp_path: Path, drive_of_3_s: list[Written], monkeypatch: pytest.MonkeyPatch
) -> None:
    track = kernel_module.track

    def stronger(reference, pose, gains, limits):  # type: ignore[no-untyped-def]
        return track(reference, pose, replace(gains, k_x=gains.k_x * 1.001), limits)

    monkeypatch.setattr(kernel_module, "track", stronger)
    report = checked(tmp_path, drive_of_3_s)
    assert report.verdict is Verdict.DIVERGED
    assert report.divergence is not None
    assert report.divergence.event.startswith("Tick ")
    assert report.divergence.recorded.startswith("PublishTwist ")
    assert "twist.linear: recorded " in report.divergence.differences[0]


def test_a_command_that_was_published_and_not_decided_is_found(
    tmp_path: Path, drive_of_3_s: list[Written]
) -> None:
    report = checked(tmp_path, [*drive_of_3_s, Twist(0.3, 0.0)])
    assert report.verdict is Verdict.BROKEN
    assert "1 commands that nobody decided on, such as 0.3 m/s" in report.violations[0].text


def test_a_command_that_goes_on_being_published_is_found(
    tmp_path: Path, drive_of_3_s: list[Written]
) -> None:
    moving = [each for each in drive_of_3_s if isinstance(each, Twist) and each.linear][-1]
    report = checked(tmp_path, [*drive_of_3_s, moving, moving])
    assert report.violation_count == 1
    assert "2 commands that nobody decided on" in report.violations[0].text


def test_a_recording_of_another_version_says_so_and_compares_decisions(
    tmp_path: Path, drive_of_3_s: list[Written]
) -> None:
    changed, _ = altered(drive_of_3_s, "Reply", "Mode changed to MOVING", "OK, moving")
    report = checked(tmp_path, changed, version="0.0.9")
    assert report.verdict is Verdict.SAME
    assert not report.bitwise
    assert report.notes[0].startswith("made by robotctl 0.0.9, this is ")
    assert checked(tmp_path / "ours", changed).verdict is Verdict.DIVERGED


def test_a_recording_without_a_journal_is_not_called_the_same(tmp_path: Path) -> None:
    report = checked(tmp_path, [Twist(), Twist()])
    assert report.verdict is Verdict.INCOMPLETE
    assert "holds no snapshot" in report.missing[0]


def test_what_a_gap_leaves_is_checked_and_the_gap_is_named(
    tmp_path: Path, drive_of_3_s: list[Written]
) -> None:
    position = 40
    report = checked(tmp_path, drive_of_3_s[:position] + drive_of_3_s[position + 3 :])
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing[0].startswith("the journal lacks")


@pytest.mark.parametrize("name", ["Tick", "OdomReceived", "DriveRequested"])
def test_a_flipped_bit_in_an_event_is_found_and_named(
    tmp_path: Path, drive_of_3_s: list[Written], name: str
) -> None:
    position, entry = [
        (position, each)
        for position, each in enumerate(drive_of_3_s)
        if isinstance(each, JournalEntry) and each.name == name
    ][-1]
    digit = next(i for i, character in enumerate(entry.data) if character in "123456789")
    flipped = chr(ord(entry.data[digit]) ^ 1)
    data = entry.data[:digit] + flipped + entry.data[digit + 1 :]
    changed = [*drive_of_3_s]
    changed[position] = entry._replace(data=data)
    report = checked(tmp_path, changed)
    assert report.verdict is Verdict.DIVERGED
    assert report.divergence is not None
    assert report.divergence.event == f"{name} {data}"
