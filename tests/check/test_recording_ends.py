"""What an honest recording may hold after the last entry of its journal, and what it may lack.

Other files in its folder excuse nothing in it. A configuration excuses the lack of the topics that
its patterns leave out, and of no others.
Honest files of other programs and other robots are never called broken, whatever they lack.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random

import pytest
from mcap.records import Channel, Schema
from mcap.writer import Writer

from robotctl.check.ends import NOT_COMPARED, SINGLE_FILE
from robotctl.check.report import Verdict
from robotctl.check.run import UNNUMBERED, check_recording
from robotctl.check.topics import MAX_TEXT
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.types import CommandPublishersSeen, Twist
from robotctl.messages.inputs import encode_twist
from robotctl.recording.format.journal import decode
from robotctl.recording.format.names import LEDGER_RECORD
from robotctl.recording.format.rosbag2 import METADATA_RECORD
from robotctl.recording.read.whole_recording import verify_recording
from robotctl.testing.drives import BEGIN_NS, drive_requested
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, Stored, write_contents
from tests.support.heard_drives import COMMANDS, JOURNAL, STATUS, heard_drive, status
from tests.tampering.edits import (
    MOTION,
    Kind,
    all_changed,
    appended,
    changed,
    check_edited,
    dropped,
    metadata,
    moves,
    removed,
    repeated_at_the_end,
    still,
)
from tests.tampering.kinds import FOUND


def halves(contents: Contents, *, queued: int = 0) -> tuple[Contents, Contents]:
    """Return what two files hold.

    The ledger of the first one may count journal entries that were `queued` for the second.
    """
    at = contents.snapshots()[1]
    first, second = contents.copy(), contents.copy()
    first.messages, second.messages = contents.messages[:at], contents.messages[at:]
    second.counts = Counter(each.topic for each in second.messages)  # its ledger counts both files
    for name, values in first.metadata:
        if name == LEDGER_RECORD:
            counts = json.loads(values[JOURNAL])
            counts |= {"received": counts["received"] + queued, "queued": queued}
            values[JOURNAL] = json.dumps(counts)
    return first, second


def write_files(folder: Path, *parts: Contents) -> Path:
    """Write files of one recording into a new folder, and return the folder."""
    folder.mkdir(parents=True)
    for number, part in enumerate(parts):
        (file,) = write_contents(folder.parent / f"part{number}", part).glob("*.mcap")
        file.rename(folder / f"{folder.name}_{number}.mcap")
        file.parent.rmdir()
    return folder


@cache
def closed() -> Contents:
    return heard_drive(3.0)


@cache
def killed() -> Contents:
    contents = closed().unclosed()
    contents.messages = closed().messages[:-20]
    return contents


OBSERVED = (
    metadata("robotctl", "mode", "observing"),
    all_changed(JOURNAL, lambda each: replace(each, publish_ns=each.publish_ns - 1000)),
    *(
        metadata("robotctl", key, None)
        for key in ("topic.robot_status", "service.set_mode", "service.estop")
    ),
)
"""An observer receives the journal, and notes no names of topics and services."""

STALL = appended(COMMANDS, (8, 8), still, every_s=0.05, after_s=0.12)
"""The zeros of a stall."""


def test_a_kill_right_after_a_stall_leaves_zeros_that_a_note_explains(tmp_path: Path) -> None:
    report = check_edited(tmp_path, killed(), STALL)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert any("the last 8 zeros have no decision" in note for note in report.notes)


def test_the_last_zeros_of_a_daemon_that_fails_are_no_more_than_two(tmp_path: Path) -> None:
    two, three = (appended(COMMANDS, (count, count), still) for count in (2, 3))
    assert check_edited(tmp_path / "two", killed(), two).verdict is Verdict.SAME
    assert check_edited(tmp_path / "three", killed(), three).verdict is Verdict.BROKEN


@pytest.mark.parametrize(("count", "verdict"), [(2, Verdict.SAME), (30, Verdict.INCOMPLETE)])
def test_messages_that_were_lost_before_the_end_are_few(
    tmp_path: Path, count: int, verdict: Verdict
) -> None:
    """The recorder has them all; the control loop lost the last ones before the last second."""
    end_ns = max(each.log_ns for each in closed().messages)

    def early(contents: Contents, random: Random) -> Contents:
        edited = contents.copy()
        last = next(each for each in reversed(contents.messages) if each.topic == BATTERY)
        edited.messages += [
            replace(last, sequence=last.sequence + 1 + number, log_ns=end_ns - 10**9 + number)
            for number in range(count)
        ]
        return edited

    report = check_edited(tmp_path, closed(), early)
    assert report.verdict is verdict
    lost = any(f"{count} messages of the battery did not reach" in note for note in report.notes)
    assert lost is (verdict is Verdict.SAME)


def test_what_others_send_after_the_observed_daemon_died_is_held_against_nobody(
    tmp_path: Path,
) -> None:
    """An observer receives the journal, and outlives it."""
    later = [
        appended(topic, (100, 100), first=10, every_s=0.1, after_s=1.0)
        for topic in (ODOMETRY, BATTERY)
    ]
    teleop = appended(
        COMMANDS, (100, 100), lambda each: replace(each, data=MOTION), first=-40, after_s=9.0
    )
    report = check_edited(tmp_path / "observed", closed().unclosed(), *OBSERVED, *later, teleop)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report
    assert any("100 commands are later than the journal" in note for note in report.notes)
    assert NOT_COMPARED in report.notes
    assert check_edited(tmp_path / "own", closed(), *later, teleop).verdict is Verdict.BROKEN


def test_files_that_were_put_together_repeat_the_last_status(tmp_path: Path) -> None:
    """Two snapshots: the second file began with the last status of the first."""
    again = repeated_at_the_end(STATUS, (1, 1), lambda each: each)
    assert check_edited(tmp_path / "once", closed(), again).verdict is Verdict.SAME
    often = check_edited(tmp_path / "often", closed(), again, again, again)
    assert often.missing == ["1 robot statuses are repeated where no file begins"]


@cache
def honest() -> Contents:
    return heard_drive(3.6, snapshots_s=(0.0, 2.0))


@cache
def forged() -> Contents:
    change = changed(COMMANDS, lambda each, _: replace(each, data=MOTION), moves)
    return change(honest(), Random(1))


def names_another_file(folder: Path) -> None:
    text = (
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - run_0.mcap\n    - run_1.mcap\n"
    )
    (folder / "metadata.yaml").write_text(text)


BESIDE: dict[str, Callable[[Path], object]] = {
    "a file of one byte after the others": lambda folder: (folder / "zz.mcap").write_bytes(b"x"),
    "a file of one byte before the others": lambda folder: (folder / "aa.mcap").write_bytes(b"x"),
    "a next file of one byte": lambda folder: (folder / "run_1.mcap").write_bytes(b"x"),
    "a next file that is named and not there": names_another_file,
}


@pytest.mark.parametrize("name", BESIDE)
def test_a_file_beside_excuses_no_forged_command(tmp_path: Path, name: str) -> None:
    for folder, contents, verdict in (
        (tmp_path / "honest" / "run", honest(), Verdict.INCOMPLETE),
        (tmp_path / "forged" / "run", forged(), Verdict.BROKEN),
    ):
        BESIDE[name](write_contents(folder, contents))
        report = check_recording(folder)
        assert report.verdict is verdict
        assert report.missing


def test_files_of_one_recording_are_checked_together(tmp_path: Path) -> None:
    report = check_recording(write_files(tmp_path / "run", *halves(honest())))
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])


@pytest.mark.parametrize("lost", [0, 1])
def test_a_file_that_is_lost_makes_nothing_broken(tmp_path: Path, lost: int) -> None:
    folder = write_files(tmp_path / "run", *halves(honest()))
    (folder / f"run_{lost}.mcap").write_bytes(b"x")
    report = check_recording(folder)
    assert (report.verdict, report.violations) == (Verdict.INCOMPLETE, [])


@pytest.mark.parametrize("queued", [0, 1])
def test_the_finished_files_of_a_recording_that_goes_on_are_not_broken(
    tmp_path: Path, queued: int
) -> None:
    """A message that arrives at a split is counted, and written to the next file."""
    first, _ = halves(honest(), queued=queued)
    report = check_recording(write_files(tmp_path / "run", first))
    assert (report.verdict, report.violations) == (Verdict.INCOMPLETE, [])
    assert len(report.missing) == 1
    assert "it was not closed, or its last file is not here" in report.missing[0]


@pytest.mark.parametrize("number", [0, 1])
def test_a_note_tells_that_the_end_of_a_single_file_may_be_cut_off(
    tmp_path: Path, number: int
) -> None:
    folder = write_files(tmp_path / "run", *halves(honest()))
    report = check_recording(folder / f"run_{number}.mcap")
    assert report.verdict is Verdict.SAME
    assert (SINGLE_FILE in report.notes) is (number == 0)


@cache
def filtered() -> Contents:
    return heard_drive(3.6)


@pytest.mark.parametrize(
    ("key", "patterns", "topic", "verdict"),
    [
        ("exclude", "['/battery_state']", BATTERY, Verdict.SAME),
        ("exclude", "['/camera/*', '/battery*']", BATTERY, Verdict.SAME),
        ("exclude", "['type:sensor_msgs/msg/BatteryState']", BATTERY, Verdict.SAME),
        ("exclude", "['/camera/*']", BATTERY, Verdict.BROKEN),
        ("exclude", "['type:sensor_msgs/msg/Image']", BATTERY, Verdict.BROKEN),
        ("include", "['/cmd_vel', '/odom']", BATTERY, Verdict.SAME),
        ("include", "['/battery_state']", BATTERY, Verdict.BROKEN),
        ("exclude", "['/odom']", ODOMETRY, Verdict.BROKEN),
        ("include", "['/cmd_vel']", ODOMETRY, Verdict.BROKEN),
        ("exclude", "/battery_state", BATTERY, Verdict.BROKEN),
        ("exclude", "[1]", BATTERY, Verdict.BROKEN),
        ("exclude", "[" * MAX_TEXT, BATTERY, Verdict.BROKEN),
    ],
)
def test_only_what_the_patterns_leave_out_may_lack(
    tmp_path: Path, key: str, patterns: str, topic: str, verdict: Verdict
) -> None:
    configured = metadata("robotctl", f"parameter.recording.{key}", patterns)
    report = check_edited(tmp_path, filtered(), configured, removed(topic))
    assert report.verdict is verdict
    assert any("as configured" in note for note in report.notes) is (verdict is Verdict.SAME)


SERVICE = (
    Channel(id=0, topic="/other/_service_event", message_encoding="cdr", schema_id=0, metadata={}),
    Schema(id=0, name="std_srvs/srv/Trigger_Event", encoding="unknown", data=b""),
)
ACTION = (
    Channel(id=0, topic="/fib/_action/status", message_encoding="cdr", schema_id=0, metadata={}),
    Schema(id=0, name="action_msgs/msg/GoalStatusArray", encoding="", data=b""),
)


def by_rosbag2(contents: Contents, *, keeps_metadata: bool = False) -> Contents:
    """Return what `ros2 bag record` and `ros2 bag convert` write: no numbers, all topics."""
    bag = contents.copy()
    bag.messages = [replace(each, sequence=0, publish_ns=each.log_ns) for each in bag.messages]
    if not keeps_metadata:
        bag.types = [*bag.types, SERVICE, ACTION]
        last_ns = bag.messages[-1].log_ns
        bag.messages += [
            Stored(each.topic, bytes(8), last_ns, last_ns, 0) for each, _ in (SERVICE, ACTION)
        ]
        bag.library = "libmcap 1.1.0"
        bag.metadata = []
    return bag


@pytest.mark.parametrize("keeps_metadata", [False, True])
def test_a_bag_of_rosbag2_is_incomplete_because_it_has_no_numbers(
    tmp_path: Path, keeps_metadata: bool
) -> None:
    bag = by_rosbag2(honest(), keeps_metadata=keeps_metadata)
    report = check_edited(tmp_path, bag)
    assert (report.verdict, report.missing) == (Verdict.INCOMPLETE, [UNNUMBERED])
    assert report.effects > 100
    assert not any("status" in note and "missing" in note for note in report.notes)


def test_a_decision_that_was_changed_in_such_a_bag_is_found(tmp_path: Path) -> None:
    bag = by_rosbag2(honest(), keeps_metadata=True)
    at, entry = next(
        (at, each)
        for at, each in enumerate(bag.messages)
        if each.topic == JOURNAL and decode(each.data).name == "PublishTwist"
        if b'"linear":0.2' in each.data
    )
    bag.messages[at] = replace(entry, data=entry.data.replace(b'"linear":0.2', b'"linear":0.1'))
    assert check_edited(tmp_path, bag).verdict is Verdict.DIVERGED


def foreign(name: bytes, first: int) -> Kind:
    """Publish a status of a node that starts later after each second one of the robot."""

    def change(contents: Contents, random: Random) -> Contents:
        edited = contents.copy()
        edited.messages = []
        number = 0
        for each in contents.messages:
            edited.messages.append(each)
            if each.topic == STATUS:
                number += 1
                if number % 2 and number > 2:
                    data = status(2, 0.5, name)
                    later = replace(each, data=data, sequence=first + number // 2 - 1)
                    edited.messages.append(later)
        return edited

    return change


@pytest.mark.parametrize(("name", "first"), [(b"other", 1), (b"other", 40), (b"robot", 1)])
def test_statuses_of_another_node_are_a_note(tmp_path: Path, name: bytes, first: int) -> None:
    report = check_edited(tmp_path, honest(), foreign(name, first))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report
    assert any("another node published robot statuses as well" in each for each in report.notes)


def test_a_channel_that_stands_only_in_the_summary_changes_nothing(tmp_path: Path) -> None:
    """Writers may repeat in the summary what they knew of, and not only what has messages."""
    target = tmp_path / "run" / "run_0.mcap"
    target.parent.mkdir()
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another program")
        channels = {}
        for channel, schema in honest().types:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        for each in honest().messages:
            writer.add_message(
                channels[each.topic], each.log_ns, each.data, each.publish_ns, each.sequence
            )
        for name, values in honest().metadata:
            if name != METADATA_RECORD:
                writer.add_metadata(name, values)
        known = writer._Writer__channels  # type: ignore[attr-defined]
        known[99] = replace(known[2], id=99, topic="/announced", metadata={})
        writer.finish()
    assert verify_recording(target.parent).wrong == ()
    report = check_recording(target.parent)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


@pytest.mark.parametrize("number", [1, 100_000])
def test_a_later_file_knows_the_publishers_that_the_file_before_noticed(
    tmp_path: Path, number: int
) -> None:
    seen = CommandPublishersSeen(BEGIN_NS + NS_PER_S, ("/teleop",))
    drive = heard_drive(8.0, requests=[drive_requested(), seen], snapshots_s=(0.0, 3.0))
    _, later = halves(drive)
    teleop = Twist(0.7, 0.1)
    at_ns = later.messages[-1].log_ns
    later.messages.append(Stored(COMMANDS, encode_twist(teleop), at_ns, at_ns, number))
    (file,) = write_contents(tmp_path / "later", later).glob("*.mcap")
    report = check_recording(file.rename(tmp_path / "run_1.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert "/teleop published as well" in " ".join(report.notes)


def test_a_message_that_may_have_been_lost_excuses_no_change_of_another_topic(
    tmp_path: Path,
) -> None:
    lost, moved = dropped(COMMANDS, 1, moves), FOUND["odometry: one moved"]
    assert check_edited(tmp_path / "lost", killed(), lost).verdict is Verdict.INCOMPLETE
    assert check_edited(tmp_path / "both", killed(), lost, moved).verdict is Verdict.BROKEN


@pytest.mark.parametrize("queued", [0, 1])
def test_a_file_that_is_not_the_last_excuses_no_forged_command(tmp_path: Path, queued: int) -> None:
    first, _ = halves(forged(), queued=queued)
    assert check_recording(write_files(tmp_path / "run", first)).verdict is Verdict.BROKEN
