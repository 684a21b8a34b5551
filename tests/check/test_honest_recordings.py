"""No honest recording is called broken, or incomplete for what it does not lack.

A clip has the journal from before its begin, but no messages of that time. Other nodes publish on
the robot's topics, with numbers of their own. A new file begins with the last latched messages.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random

import pytest

from robotctl.check.inputs import Input, InputPairs
from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from robotctl.config import Config
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import (
    CommandParams,
    KernelParams,
    OdometryParams,
    OdometryQos,
    WhenIdle,
)
from robotctl.kernel.safety_inputs import EstopParams, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import (
    Event,
    ForeignCommandHeard,
    GuardedCommandReceived,
    ModeRequested,
    SafetyInputReceived,
    Twist,
)
from robotctl.messages.inputs import encode_twist
from robotctl.recording import Moment, Recording, cut_clip
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.read.messages import Message
from robotctl.recording.read.whole_recording import verify_recording
from robotctl.testing.drives import BEGIN_NS, drive, record
from robotctl.testing.hearing import BATTERY, ODOMETRY, TOPICS, WANTED
from tests.check.test_recording_ends import OBSERVED, halves, write_files
from tests.support.edited_recordings import Contents
from tests.support.heard_drives import COMMANDS, ESTOP, STATUS, heard_drive, status
from tests.tampering.edits import check_edited, metadata, renamed

BUTTON = TOPICS[SafetyInput.ESTOP]


def at(seconds: float) -> int:
    return BEGIN_NS + round(seconds * NS_PER_S)


def checked_clip(folder: Path, source: Path, begin_s: float, end_s: float) -> Report:
    """Check a clip of a recording, from and until a time after its begin."""
    with Recording(source) as recording:
        begin_ns = recording.info().start_ns
        window = begin_ns + round(begin_s * NS_PER_S), begin_ns + round(end_s * NS_PER_S)
        clip = cut_clip(recording, Moment(window[0]), window, folder / "clip.mcap")
    return check_recording(clip.target)


def asked(seconds: float, mode: Mode) -> ModeRequested:
    """Request a mode by a call of its service."""
    service = "estop" if mode is Mode.EMERGENCY_STOP else "set_mode"
    return ModeRequested(
        at(seconds), round(seconds * 1e3), mode.value, f"the ROS service /{service}"
    )


SILENT = KernelParams(command=CommandParams(when_idle=WhenIdle.SILENT))
GUARD = KernelParams(guard=True)


WANTED_FOR_2_S = [GuardedCommandReceived(at(0.3 + n / 10.0), Twist(0.1)) for n in range(25)]


@pytest.mark.parametrize(
    ("params", "events", "begin_s"),
    [
        (KernelParams(), [asked(1.0, Mode.ERROR), asked(1.1, Mode.IDLE)], 3.0),
        (SILENT, [], 3.0),
        (GUARD, [asked(0.2, Mode.MOVING), *WANTED_FOR_2_S], 3.0),
        # Two calls for one mode, of which the clip has only the second.
        (KernelParams(), [asked(1.0, Mode.EMERGENCY_STOP), asked(1.2, Mode.EMERGENCY_STOP)], 1.1),
    ],
    ids=["calls", "commands", "wanted", "one of two calls"],
)
def test_a_clip_need_not_hold_what_was_before_it(
    tmp_path: Path, params: KernelParams, events: list[Event], begin_s: float
) -> None:
    made = heard_drive(5.0, requests=events, config=Config(kernel=params))
    source = write_files(tmp_path / "run", made)
    report = checked_clip(tmp_path, source, begin_s, 4.5)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_clip_from_before_a_parameter_was_changed_is_whole(tmp_path: Path) -> None:
    """Its metadata is that of its source, whose last file tells the changed value."""
    first, second = halves(heard_drive(4.0, snapshots_s=(0.0, 2.0)))
    change = metadata("robotctl", "parameter.battery.stop_level", "0.1")
    source = write_files(tmp_path / "run", first, change(second, Random(1)))
    report = checked_clip(tmp_path, source, 0.5, 1.5)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_zero_of_another_node_is_none_of_the_commands_before_a_clip(tmp_path: Path) -> None:
    heard = ForeignCommandHeard(at(3.0), "/teleop")
    made = heard_drive(5.0, requests=[heard])
    place = next(i for i, each in enumerate(made.messages) if b"/teleop" in each.data)
    zero = replace(made.messages[place], topic=COMMANDS, data=encode_twist(Twist()), sequence=1)
    made.messages.insert(place, zero)
    report = checked_clip(tmp_path, write_files(tmp_path / "run", made), 2.0, 4.5)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def with_latched(contents: Contents, topic: str) -> Contents:
    """Return the contents with a topic that is transient local."""
    edited = contents.copy()
    qos = {"offered_qos_profiles": f"- {LATCHED_QOS}"}
    edited.types = [
        (replace(each, metadata={**each.metadata, **qos}) if each.topic == topic else each, schema)
        for each, schema in edited.types
    ]
    return edited


def test_each_file_may_begin_with_a_repeat_of_the_last_command(tmp_path: Path) -> None:
    """Where `command.qos` is transient-local; the last one may be recorded after its repeat."""
    drive = with_latched(heard_drive(4.0, snapshots_s=(0.0, 2.0)), COMMANDS)
    first, second = halves(drive)
    place = [i for i, each in enumerate(second.messages) if each.topic == COMMANDS][2]
    again = second.messages.pop(place)
    begin_ns = second.messages[0].log_ns
    last = [each for each in first.messages if each.topic == COMMANDS][-1]
    second.messages[0:0] = [replace(each, log_ns=begin_ns) for each in (last, again)]
    second.messages.insert(place + 2, again)
    folder = write_files(tmp_path / "run", first, second)
    for path in (folder, folder / "run_1.mcap"):
        report = check_recording(path)
        assert (report.verdict, report.missing) == (Verdict.SAME, []), report


@cache
def pressed() -> Contents:
    """A drive with a button whose message comes ten times a second."""
    inputs = SafetyInputParams(estop=EstopParams(Use.OPTIONAL))
    requests: list[Event] = [
        SafetyInputReceived(at(0.1 + number / 10.0), SafetyInput.ESTOP, float(20 <= number < 30))
        for number in range(40)
    ]
    config = Config(kernel=KernelParams(inputs=inputs))
    return heard_drive(5.0, requests=requests, config=config)


def beside(contents: Contents, topic: str) -> Contents:
    """Add the messages of another publisher, which none of the inputs came from."""
    edited = contents.copy()
    edited.messages = []
    for each in contents.messages:
        edited.messages.append(each)
        if each.topic == topic and each.sequence > 5:
            later = replace(each, log_ns=each.log_ns + 1, publish_ns=each.publish_ns + 1)
            edited.messages.append(replace(later, sequence=each.sequence - 5))
    return edited


def test_another_publisher_of_an_input_repeats_nothing(tmp_path: Path) -> None:
    report = check_edited(tmp_path, beside(pressed().unclosed(), BUTTON))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_wanted_velocities_count_only_with_a_guard(tmp_path: Path) -> None:
    wanted: list[Event] = [asked(0.2, Mode.MOVING), *WANTED_FOR_2_S]
    guarded = heard_drive(3.0, requests=wanted, config=Config(kernel=GUARD))
    made = heard_drive(3.0)
    made.types += [each for each in guarded.types if each[0].topic == WANTED]
    found = [each for each in guarded.messages if each.topic == WANTED]
    made.messages += [*found, *found]
    assert check_edited(tmp_path, made.unclosed()).verdict is Verdict.SAME


def test_a_latched_input_may_be_repeated_before_its_original(tmp_path: Path) -> None:
    first, *_ = places = [i for i, each in enumerate(pressed().messages) if each.topic == BUTTON]
    edited = with_latched(pressed(), BUTTON)
    edited.messages.insert(first + 1, edited.messages[places[3]])
    assert check_edited(tmp_path, edited.unclosed()).verdict is Verdict.SAME


def test_the_rate_of_an_input_that_was_heard_once_is_unknown(tmp_path: Path) -> None:
    """Equal messages become no inputs for a quarter of its timeout."""
    last = next(i for i, each in enumerate(pressed().messages) if each.topic == BUTTON)
    edited = pressed().unclosed()
    edited.messages = edited.messages[: last + 1]
    button = edited.messages[-1]
    edited.messages += [
        replace(button, sequence=2 + n, publish_ns=button.publish_ns + n) for n in range(15)
    ]
    report = check_edited(tmp_path, edited)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_the_first_messages_of_a_second_publisher_may_lack() -> None:
    """Others of their numbers are of the first publisher, or of one that was never heard."""
    pairs = InputPairs()

    def send(number: int, sent_ns: int, level: float) -> None:
        pairs.message(Message(BATTERY, "", b"", sent_ns, sent_ns, number), level)

    for number in range(1, 9):
        pairs.received(number, Input(number, "first", 0.8, number))
        send(number, number, 0.8)
    send(3, 10, 0.1)
    for number in range(1, 9):
        pairs.received(number, Input(number + 20, "second", 0.5, number + 20))
        if number > 5:
            send(number, number + 20, 0.5)
    pairs.end(NS_PER_S, 0)
    assert (pairs.differing, pairs.lacking, pairs.before_found) == (0, 0, 5)


def test_latched_statuses_of_another_node_are_no_gap(tmp_path: Path) -> None:
    """A later file that is checked alone begins with the last status of each node."""
    first, second = halves(heard_drive(5.0, snapshots_s=(0.0, 3.0)))
    begin_ns = second.messages[0].log_ns
    last = [each for each in first.messages if each.topic == STATUS][-1]
    own = replace(last, log_ns=begin_ns)
    second.messages[0:0] = [replace(own, data=status(2, 0.5), sequence=1), own]
    folder = write_files(tmp_path / "run", second)
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_clip_may_end_before_a_status_that_a_file_began_with(tmp_path: Path) -> None:
    """A recorder that lags begins a file with the newest status, which waits to be written."""
    first, second = halves(heard_drive(6.0, snapshots_s=(0.0, 3.0)))
    newest = [each for each in second.messages if each.topic == STATUS][-1]
    second.messages[0:0] = [replace(newest, log_ns=second.messages[0].log_ns)]
    source = write_files(tmp_path / "run", first, second.unclosed())
    report = checked_clip(tmp_path, source, 1.0, 4.5)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_the_copies_at_one_beginning_of_a_file_count_once(tmp_path: Path) -> None:
    """They are of two nodes, and one of a status that waits to be written."""
    made = heard_drive(6.0, snapshots_s=(0.0, 3.0))
    foreign, *others = [each for each in made.messages if each.topic == STATUS]
    foreign = replace(foreign, data=status(2, 0.5, b"other"), sequence=1)
    made.messages.insert(made.messages.index(others[0]), foreign)
    for own in others[1:3]:
        place = made.messages.index(own)
        copies = [replace(each, log_ns=own.log_ns) for each in (foreign, own)]
        made.messages[place : place + 1] = [*copies, replace(own, log_ns=own.log_ns + 1_000)]
    report = check_edited(tmp_path, made.unclosed())
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


@pytest.mark.parametrize("topic", [ODOMETRY, COMMANDS])
def test_an_observed_robot_may_give_a_topic_another_name(tmp_path: Path, topic: str) -> None:
    report = check_edited(tmp_path, heard_drive(5.0), *OBSERVED, renamed(topic))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_the_first_messages_of_a_later_file_may_be_of_two_publishers(tmp_path: Path) -> None:
    """Their inputs are in the file before."""
    _, second = halves(heard_drive(4.0, snapshots_s=(0.0, 2.0)))
    place = next(i for i, each in enumerate(second.messages) if each.topic == ODOMETRY)
    begin = replace(second.messages[0], topic=ODOMETRY, data=second.messages[place].data)
    second.messages[1:1] = [
        replace(begin, sequence=7, publish_ns=begin.log_ns + 1),
        replace(begin, sequence=1, publish_ns=begin.log_ns + 2),
    ]
    folder = write_files(tmp_path / "run", second.unclosed())
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_later_file_may_begin_with_calls_of_requests_before_it(tmp_path: Path) -> None:
    events = [asked(1.95, Mode.EMERGENCY_STOP), asked(2.1, Mode.EMERGENCY_STOP)]
    first, second = halves(heard_drive(4.0, snapshots_s=(0.0, 2.0), requests=events))
    second.messages[1:1] = [each for each in first.messages if each.topic == ESTOP]
    folder = write_files(tmp_path / "run", second.unclosed())
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_another_node_may_overtake_the_numbers_of_our_statuses(tmp_path: Path) -> None:
    made = heard_drive(5.0)
    place = [i for i, each in enumerate(made.messages) if each.topic == STATUS][2]
    own = made.messages[place]
    made.messages[place + 1 : place + 1] = [
        replace(own, data=status(2, 0.5), sequence=number) for number in range(1, 9)
    ]
    report = check_edited(tmp_path, made.unclosed())
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_file_in_which_another_node_comes_first_names_no_wrong_mode(tmp_path: Path) -> None:
    _, second = halves(heard_drive(5.0, snapshots_s=(0.0, 3.0)))
    place = next(i for i, each in enumerate(second.messages) if each.topic == STATUS)
    own = second.messages[place]
    foreign = [replace(own, data=status(2, 0.5), sequence=number) for number in (1, 2)]
    second.messages[place : place + 1] = [foreign[0], own, foreign[1]]
    folder = write_files(tmp_path / "run", second.unclosed())
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert report.missing == ["1 robot statuses are out of order, or another node publishes them"]


def test_the_control_loop_may_hear_reliable_odometry_alone(tmp_path: Path) -> None:
    params = KernelParams(odometry=OdometryParams(qos=OdometryQos.RELIABLE))
    made = heard_drive(3.0, config=Config(kernel=params))
    report = check_edited(tmp_path, beside(made.unclosed(), ODOMETRY))
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_the_zeros_of_another_node_may_have_our_numbers(tmp_path: Path) -> None:
    made = heard_drive(5.0, requests=[ForeignCommandHeard(at(3.0), "/teleop")])
    place = next(i for i, each in enumerate(made.messages) if b"/teleop" in each.data)
    number = max(each.sequence for each in made.messages[:place] if each.topic == COMMANDS) + 1
    zero = replace(made.messages[place], topic=COMMANDS, data=encode_twist(Twist()))
    made.messages[place:place] = [replace(zero, sequence=number + n) for n in (2, 1, 0)]
    report = check_edited(tmp_path, made.unclosed())
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_a_file_may_hold_statuses_of_another_node_alone(tmp_path: Path) -> None:
    first, second = halves(heard_drive(6.0, snapshots_s=(0.0, 3.0)))
    last = [each for each in first.messages if each.topic == STATUS][-1]
    foreign = replace(last, data=status(2, 0.5, b"other"), sequence=1)
    second.messages = [each for each in second.messages if each.topic != STATUS]
    second.messages[:1] = [
        replace(last, log_ns=second.messages[0].log_ns),
        second.messages[0],
        foreign,
    ]
    second.counts = Counter(each.topic for each in second.messages)
    folder = write_files(tmp_path / "run", second)
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert "robot statuses are wrong" not in str((report.violations, report.missing))
    assert any("another node published robot statuses" in each for each in report.notes)


def test_numbers_that_a_file_began_beyond_are_no_gap(tmp_path: Path) -> None:
    """Another node begins to publish statuses of our name in a file that is checked alone."""
    first, second = halves(heard_drive(6.0, snapshots_s=(0.0, 3.0)))
    place = next(i for i, each in enumerate(second.messages) if each.topic == STATUS)
    own = second.messages[place]
    second.messages.insert(place, replace(own, data=status(2, 0.5), sequence=1))
    last = [each for each in first.messages if each.topic == STATUS][-1]
    second.messages.insert(0, replace(last, log_ns=second.messages[0].log_ns))
    second.counts = Counter(each.topic for each in second.messages)
    folder = write_files(tmp_path / "run", second)
    report = check_recording((folder / "run_0.mcap").rename(folder / "run_1.mcap"))
    assert "robot statuses are missing" not in str((report.violations, report.missing))


def test_an_input_may_be_heard_in_the_file_after_its_message(tmp_path: Path) -> None:
    """The last message of a file may be the first of another publisher."""
    first, _ = halves(heard_drive(4.0, snapshots_s=(0.0, 2.0)))
    place = [i for i, each in enumerate(first.messages) if each.topic == BATTERY][-1]
    last = first.messages[place]
    later = replace(last, sequence=1, log_ns=last.log_ns + 1, publish_ns=last.publish_ns + 1)
    first.messages.insert(place + 1, later)
    (file,) = write_files(tmp_path / "run", first.unclosed()).glob("*.mcap")
    assert check_recording(file).verdict is Verdict.SAME


def test_a_status_may_be_newer_than_the_journal_of_a_killed_daemon(tmp_path: Path) -> None:
    made = heard_drive(3.0).unclosed()
    last = [each for each in made.messages if each.topic == STATUS][-1]
    end_ns = made.messages[-1].log_ns + 10_000_000
    newer = replace(last, data=status(3, 0.5), sequence=last.sequence + 1, publish_ns=end_ns)
    made.messages.append(replace(newer, log_ns=end_ns))
    report = check_edited(tmp_path, made)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report


def test_the_list_of_files_may_be_of_before_the_end_of_the_last_file(tmp_path: Path) -> None:
    """A daemon may be killed after it finished a file, and before it wrote the list."""
    folder = record(tmp_path / "run", drive(2.0))
    path = folder / "metadata.yaml"
    total = verify_recording(folder).files[0].data.message_count
    text = path.read_text().replace(f"message_count: {total}", f"message_count: {total - 7}")
    path.write_text(text)
    assert verify_recording(folder).flaws == ()
    path.write_text(text.replace(f"message_count: {total - 7}", f"message_count: {total}", 1))
    assert verify_recording(folder).flaws
