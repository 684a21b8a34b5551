"""Each velocity command on the wire is a decision of the journal, in its order, and the reverse."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from robotctl.check.commands import CommandPairs, numbers_of
from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from robotctl.kernel.codec import Proof
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.state import Health
from robotctl.kernel.types import ForeignCommandHeard, LoopStalled, ModeRequested, Tick, Twist
from robotctl.messages.inputs import encode_twist
from robotctl.recording.format.journal import JournalEntry
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested
from tests.support.cases import for_each
from tests.support.checked_drives import altered, checked, from_snapshot, rechained
from tests.support.edited_recordings import Contents, edit, recorded, write_contents
from tests.tampering.edits import check_edited

COMMANDS = "/cmd_vel"

Edit = Callable[[list[Written]], list[Written]]

ESTOP = ModeRequested(BEGIN_NS + 2_000_000_000, 2, 3, "operator")


def moving(written: list[Written]) -> list[int]:
    """Return the positions of the commands that are not zero."""
    return [at for at, each in enumerate(written) if isinstance(each, Twist) and each != Twist()]


@cache
def stopped_drive() -> list[Written]:
    """A drive that an emergency stop ends after 2 s."""
    return drive(6.0, requests=[drive_requested(), ESTOP])


def found(tmp_path: Path, written: list[Written]) -> tuple[Verdict, str]:
    report = checked(tmp_path, written)
    return report.verdict, " ".join([*(each.text for each in report.violations), *report.missing])


def with_motion_after_the_stop(written: list[Written]) -> list[Written]:
    last = max(at for at, each in enumerate(written) if isinstance(each, Twist)) - 40
    return [*written[:last], *[Twist(0.2, 0.0)] * 20, *written[last:]]


EDITS: list[tuple[Edit, str]] = [
    (with_motion_after_the_stop, "commands without a decision, such as 0.2 m/s"),
    (lambda written: [each for each in written if not isinstance(each, Twist)], "none of"),
]


@pytest.mark.parametrize(("change", "said"), EDITS, ids=["motion after the stop", "none"])
def test_other_commands_than_the_decided_are_found(tmp_path: Path, change: Edit, said: str) -> None:
    verdict, text = found(tmp_path, change(stopped_drive()))
    assert verdict is Verdict.BROKEN
    assert said in text


@cache
def contents() -> Contents:
    return recorded(stopped_drive())


@pytest.mark.parametrize("count", [1, 50])
def test_removed_commands_are_found_by_their_number(tmp_path: Path, count: int) -> None:
    gone = range(60, 60 + count)
    edited = edit(contents(), COMMANDS, lambda at, each: None if at in gone else each)
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith(
        f"{count} decided commands are missing, the first is command 61 "
    )


def test_another_publisher_explains_what_it_sent_and_nothing_else(tmp_path: Path) -> None:
    heard = ForeignCommandHeard(BEGIN_NS + 1_000_000_000, "/teleop")
    own = recorded(drive(9.0, requests=[drive_requested(), heard]))
    at = next(i for i, each in enumerate(own.messages) if b"/teleop" in each.data)
    foreign = replace(own.messages[at], topic=COMMANDS, data=encode_twist(Twist(0.7, 0.1)))
    for folder, place, verdict in (
        ("near", at, Verdict.SAME),
        ("far", len(own.messages), Verdict.BROKEN),
    ):
        edited = own.copy()
        edited.messages.insert(place, foreign)
        report = check_edited(tmp_path / folder, edited)
        assert report.verdict is verdict
        assert ("/teleop published as well" in " ".join(report.notes)) is (folder == "near")


def stalled(tmp_path: Path, zeros: int, withheld: int) -> Report:
    """Check a drive in which three zeros were sent, and one command was withheld."""
    stall = LoopStalled(BEGIN_NS + 1_200_000_000, 0.3, 3, 1, "somewhere")
    written = drive(2.0, requests=[drive_requested(), stall])
    at = next(i for i, each in enumerate(written) if "LoopStalled" in str(each))
    command = max(i for i, each in enumerate(written[:at]) if isinstance(each, Twist))
    assert written[command] != Twist()
    edited = list(written)
    edited[command] = Twist()
    counts = f'"zeros":{zeros},"withheld":{withheld}'
    changed, _ = altered(edited, "LoopStalled", '"zeros":3,"withheld":1', counts)
    return checked(tmp_path, changed)


def test_the_zeros_of_a_stall_are_explained(tmp_path: Path) -> None:
    report = stalled(tmp_path, 3, 1)
    assert (report.verdict, report.notes) == (Verdict.SAME, [])


@pytest.mark.parametrize(("zeros", "withheld"), [(2, 1), (3, 0), (4, 1)])
def test_zeros_that_no_stall_counts_are_found(tmp_path: Path, zeros: int, withheld: int) -> None:
    assert stalled(tmp_path, zeros, withheld).verdict is not Verdict.SAME


def test_commands_of_the_file_before_may_be_recorded_after_the_snapshot(tmp_path: Path) -> None:
    whole = recorded(drive(4.0, snapshots_s=(0.0, 2.0)))
    begin = whole.snapshots()[1]
    before = [each for each in whole.messages[:begin] if each.topic == COMMANDS][-4:]
    file = whole.copy()
    file.messages = whole.messages[begin:]
    file.messages[8:8] = before
    report = check_recording(write_contents(tmp_path / "run", file).joinpath("run_0.mcap"))
    assert (report.verdict, report.violations) == (Verdict.SAME, []), report


def test_what_was_found_before_a_message_that_is_cut_short_stays_found(tmp_path: Path) -> None:
    written = drive(3.0, snapshots_s=(0.0, 1.0))
    for at, each in enumerate(written):
        if isinstance(each, JournalEntry):
            data = re.sub(r'"journal_crc":[1-9]', '"journal_crc":', each.data)
            written[at] = each._replace(data=data)
    whole = recorded(written)
    cut = edit(whole, COMMANDS, lambda n, each: replace(each, data=b"") if n == 120 else each)
    assert check_edited(tmp_path, cut).verdict is Verdict.BROKEN


def counting_one_more(written: list[Written], snapshot: int) -> list[Written]:
    """Return the recording with one more command counted by a snapshot, and that zero before it."""
    entry, *rest = from_snapshot(written, snapshot)
    assert isinstance(entry, JournalEntry)
    data = re.sub(r'"commands":(\d+)', lambda found: f'"commands":{int(found[1]) + 1}', entry.data)
    before = written[: -1 - len(rest)]
    return rechained([*before, Twist(), entry._replace(data=data), *rest])


def test_the_last_zero_of_a_daemon_that_failed_is_explained_by_the_last_snapshot_alone(
    tmp_path: Path,
) -> None:
    written = drive(3.0, snapshots_s=(0.0, 2.0))
    ended = checked(tmp_path / "ended", counting_one_more(written, -1))
    assert (ended.verdict, ended.missing) == (Verdict.SAME, [])
    assert checked(tmp_path / "amid", counting_one_more(written, 1)).verdict is not Verdict.SAME


def test_a_big_endian_command_is_read() -> None:
    little = encode_twist(Twist(0.1, 0.2))
    values = b"".join(little[i : i + 8][::-1] for i in range(4, 52, 8))
    assert numbers_of(b"\x00\x00\x00\x00" + values) == numbers_of(little)


@for_each(("later_ns", "extra"), [(NS_PER_S, 0), (3 * NS_PER_S, 1)])
def test_a_number_of_before_the_first_snapshot_is_old_only_for_a_while(
    later_ns: int, extra: int
) -> None:
    pairs = CommandPairs()
    pairs.resume(Proof(5000, 0), Health(), 1)
    pairs.step(Tick(later_ns), (), (later_ns, 0, 0))
    pairs.message(10, encode_twist(Twist(0.3, 0.0)), 0)
    pairs.end(0, is_own=True, is_closed=True)
    assert pairs.counts.extra == extra


def test_the_last_commands_of_a_closed_recording_are_missed(tmp_path: Path) -> None:
    last = [at for at, each in enumerate(stopped_drive()) if isinstance(each, Twist)][-3:]
    edited = [each for at, each in enumerate(stopped_drive()) if at not in last]
    assert found(tmp_path, edited) == (
        Verdict.INCOMPLETE,
        "the last 3 decided commands are missing",
    )
