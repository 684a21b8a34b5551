"""Recordings of other versions and platforms are compared by the rules of docs/replay.md.

A type with other fields is named. A check decides across changes of parameters.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

from robotctl import __version__
from robotctl.base import retired
from robotctl.check.incident import find_incident
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import DriveRequested, Event, ModeRequested, ParameterRequested
from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording import Recorder, RecorderOptions
from robotctl.recording.format.journal import EntryKind, JournalEntry, encode
from robotctl.recording.format.names import MADE_BY, SHADOW_RECORD
from robotctl.testing.drives import (
    BEGIN_NS,
    Written,
    drive,
    drive_requested,
    installed_topic,
    record,
)
from tests.support.checked_drives import (
    altered,
    checked,
    drive_of_3_s,
    entries_of,
    with_entries,
    with_snapshots,
)
from tests.support.edited_recordings import recorded
from tests.tampering.edits import check_edited, described, with_type_hash


def test_a_recording_of_another_version_says_so_and_compares_decisions(tmp_path: Path) -> None:
    changed, _ = altered(drive_of_3_s(), "Reply", "Mode changed to MOVING", "OK, moving")
    report = checked(tmp_path, changed, version="0.0.9")
    assert report.verdict is Verdict.SAME
    assert not report.bitwise
    assert report.notes[0].startswith("made by robotctl 0.0.9, this is ")
    assert checked(tmp_path / "ours", changed).verdict is Verdict.DIVERGED


OTHER_RULES = f"decided by the rules of another version (0.0.9, this is {__version__}): "


def test_what_another_version_decides_otherwise_is_incomplete_and_not_a_fault(
    tmp_path: Path,
) -> None:
    changed, seq = altered(drive_of_3_s(), "PublishTwist", '"linear":0.54', '"linear":0.5400001')
    report = checked(tmp_path, changed, version="0.0.9")
    assert report.violations == []
    assert (report.verdict, report.verdict.exit_code) == (Verdict.INCOMPLETE, 6)
    assert len(report.missing) == 1
    assert report.missing[0].startswith(f"{OTHER_RULES}entry {seq}, after Tick: twist.linear: ")
    assert report.divergence is not None
    ours = checked(tmp_path / "ours", changed)
    assert (ours.verdict, ours.verdict.exit_code) == (Verdict.DIVERGED, 7)


@pytest.mark.parametrize(
    ("name", "old", "new", "unknown"),
    [
        ("Tick", '"missed":', '"late_s":0.5,"missed":', "'Tick.late_s' is not known"),
        ("OdomReceived", '"x":', '"z":0.5,"x":', "'OdomReceived.odometry.pose.z' is not known"),
        ("PublishTwist", '"twist":', '"gid":[],"twist":', "'PublishTwist.gid' is not known"),
        ("Snapshot", '"mode":', '"mood":1,"mode":', "'Snapshot.state.mood' is not known"),
    ],
)
def test_a_field_of_another_version_that_is_not_known_is_named(
    tmp_path: Path, name: str, old: str, new: str, unknown: str
) -> None:
    changed, seq = altered(drive_of_3_s(), name, old, new)
    report = checked(tmp_path, changed, version="0.0.9")
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing == [f"{OTHER_RULES}entry {seq}: {unknown}"]
    assert report.divergence is None


@pytest.mark.parametrize("name", ["Tick", "PublishTwist", "Snapshot"])
def test_a_name_of_another_version_that_is_not_known_is_named(tmp_path: Path, name: str) -> None:
    _, seq = altered(drive_of_3_s(), name, "{", "{")
    changed = with_entries(
        drive_of_3_s(), lambda each: each._replace(name="Unheard") if each.seq == seq else each
    )
    report = checked(tmp_path, changed, version="0.0.9")
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing[0].startswith(f"{OTHER_RULES}journal entry {seq} cannot be read: ")
    assert "'Unheard'" in report.missing[0]


@pytest.mark.parametrize(
    ("old", "new", "how"),
    [
        ('"mode":', '"mood":1,"mode":', "has state.mood"),
        (',"waiting":[]', "", "lacks state.waiting"),
    ],
)
def test_a_journal_with_other_fields_is_of_another_version_and_not_diverged(
    tmp_path: Path, old: str, new: str, how: str
) -> None:
    report = checked(tmp_path, with_snapshots(drive_of_3_s(), old, new))
    assert report.verdict is Verdict.INCOMPLETE
    named = f"written by another version that calls itself {__version__}: its state {how}"
    assert report.missing[0] == named
    assert report.violations == []


@pytest.mark.parametrize("cause", retired.CAUSES)
def test_a_retired_cause_is_named(tmp_path: Path, cause: str) -> None:
    changed, seq = altered(drive_of_3_s(), "Snapshot", '"cause":null', f'"cause":"{cause}"')
    report = checked(tmp_path, changed)
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing[0] == (
        f"journal entry {seq} cannot be read: it names {cause!r}, which is retired: "
        f"{retired.CAUSES[cause]}"
    )


@pytest.mark.parametrize("version", [__version__, "0.0.9"])
@pytest.mark.parametrize("value", ["false", "true"])
def test_a_retired_field_is_ignored_at_its_default_and_named_at_another_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str, value: str
) -> None:
    monkeypatch.setattr(retired, "JOURNAL_FIELDS", {"Snapshot.state.moody": False})
    changed = with_snapshots(drive_of_3_s(), '"mode":', f'"moody":{value},"mode":')
    report = checked(tmp_path, changed, version=version)
    if value == "false":
        assert (report.verdict, report.missing) == (Verdict.SAME, [])
    else:
        assert report.verdict is Verdict.INCOMPLETE
        assert "state.moody" in report.missing[0]


@pytest.mark.parametrize(("digits", "same"), [("e-13", True), ("e-7", False)])
def test_floats_that_a_c_library_rounded_may_differ_by_a_billionth(
    tmp_path: Path, digits: str, same: bool
) -> None:
    def rounded(entry: JournalEntry) -> JournalEntry:
        is_early = entry.name == "PublishTwist" and entry.seq < 20
        data = entry.data.replace('"linear":0.0,', f'"linear":1{digits},')
        return entry._replace(data=data) if is_early else entry

    elsewhere = with_snapshots(drive_of_3_s(), MADE_BY, "another")
    report = checked(tmp_path, with_entries(elsewhere, rounded))
    assert (report.divergence is None) is same
    assert not report.bitwise
    assert report.notes[0].startswith("made with another, whose C library ")


def test_what_a_second_kernel_decided_in_an_old_recording_is_no_journal(tmp_path: Path) -> None:
    entry = encode(JournalEntry(1, 0, EntryKind.EFFECT, "Nothing", "{}"))
    channel: int | None = None

    def beside(recorder: Recorder, time_ns: int) -> None:
        nonlocal channel
        if channel is None:
            channel = recorder.add_topic(installed_topic("/robotctl/shadow", JOURNAL_ENTRY))
        recorder.write(channel, entry, time_ns, time_ns, 0, bytes(16))

    estop = ModeRequested(BEGIN_NS + 1_000_000_000, 2, 3, "operator")
    records = {SHADOW_RECORD: {"file": "next.yaml", "parameter.tracking.k_y": "8.0"}}
    folder = record(
        tmp_path / "run",
        drive(1.2, requests=[drive_requested(), estop]),
        beside=beside,
        options=RecorderOptions(records=records),
    )
    report = check_recording(folder)
    assert (report.verdict, report.notes) == (Verdict.SAME, [])
    assert find_incident(folder).incident is not None


OTHER_HASH = f"RIHS01_{0:064}"
UNTOLD = "/cmd_vel is recorded without the definition of its type"
ANOTHER = (
    "/cmd_vel is recorded with another version of geometry_msgs/msg/Twist than the check reads"
)


@pytest.mark.parametrize(("type_hash", "said"), [(OTHER_HASH, ANOTHER), ("", UNTOLD)])
def test_a_type_of_another_or_no_version_is_missed(
    tmp_path: Path, type_hash: str, said: str
) -> None:
    told = described(lambda channel, schema: with_type_hash(channel, schema, type_hash), "/cmd_vel")
    report = check_edited(tmp_path, recorded(drive_of_3_s()), told)
    assert (report.verdict, report.missing) == (Verdict.INCOMPLETE, [said])


KEY = "limits.linear_mps"


def requests() -> list[Event]:
    """A drive, a stop, two changes of a limit, the second while MOVING, and another drive."""

    def at(after_s: float) -> int:
        return BEGIN_NS + round(after_s * NS_PER_S)

    return [
        DriveRequested(at(0.1), 1, Pattern(), 0, False, "operator"),
        ModeRequested(at(1.0), 2, Mode.IDLE, "operator"),
        ParameterRequested(at(2.0), 3, KEY, "0.6", "0.3", "operator"),
        DriveRequested(at(2.1), 4, Pattern(), 0, False, "operator"),
        ParameterRequested(at(2.5), 5, KEY, "0.3", "0.5", "operator"),
    ]


@cache
def parameter_drive() -> list[Written]:
    return drive(3.5, requests=requests(), snapshots_s=(0.0, 1.5, 3.0))


def test_a_drive_with_a_change_is_the_same(tmp_path: Path) -> None:
    report = check_recording(record(tmp_path / "r", parameter_drive()))
    assert (report.verdict, report.missing, report.violations) == (Verdict.SAME, [], [])
    changes = [each for each in entries_of(parameter_drive()) if each.name == "ParameterChanged"]
    assert [json.loads(each.data) for each in changes] == [
        {"key": KEY, "old": "0.6", "new": "0.3", "source": "operator"}
    ]


@pytest.mark.parametrize("version", ["0.1.0", __version__])
def test_a_snapshot_with_another_parameter_is_found_in_every_version(
    tmp_path: Path, version: str
) -> None:
    old, new = '"linear_mps":0.6', '"linear_mps":0.9'  # the last one before the limit changes
    changed, _ = altered(parameter_drive(), "Snapshot", old, new)
    report = checked(tmp_path, changed, version=version)
    assert report.divergence is not None
    assert report.verdict is not Verdict.SAME


def test_a_change_while_moving_breaks_a_promise(tmp_path: Path) -> None:
    """As a kernel would record it that forgot the rule: the invariants are independent of it."""
    text = '{"key":"limits.linear_mps","old":"0.3","new":"0.5","source":"operator"}'

    def edit(entry: JournalEntry) -> JournalEntry:
        if entry.name == "Reply" and '"request_id":5' in entry.data:
            return entry._replace(name="ParameterChanged", data=text)
        return entry

    report = checked(tmp_path, with_entries(parameter_drive(), edit))
    assert report.verdict in (Verdict.DIVERGED, Verdict.BROKEN)


def test_a_broken_promise_of_another_version_stays_a_fault(tmp_path: Path) -> None:
    changed, _ = altered(drive_of_3_s(), "PublishTwist", '"linear":0.3', '"linear":99.3')
    assert checked(tmp_path, changed, version="0.0.9").verdict is Verdict.BROKEN


@pytest.mark.parametrize("version", [__version__, "0.0.9"])
def test_an_entry_that_is_nested_too_deeply_is_named(tmp_path: Path, version: str) -> None:
    nested = '"x":' + "[" * 50_000 + "]" * 50_000 + ',"missed":'
    changed, seq = altered(drive_of_3_s(), "Tick", '"missed":', nested)
    report = checked(tmp_path, changed, version=version)
    assert report.verdict is Verdict.INCOMPLETE
    assert f"journal entry {seq} cannot be" in report.missing[0]
