"""Each odometry sample, battery level, scan and wanted velocity in the journal was recorded.
The safety inputs of a journal are the recorded messages, and no change of them is left out.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Container
from dataclasses import replace
from functools import cache
from math import inf, nan
from pathlib import Path
from random import Random

import pytest

from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.config import Config
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, ScanParams
from robotctl.kernel.safety_inputs import (
    BumperParams,
    DiagnosticsParams,
    EstopParams,
    JoyParams,
    SafetyInput,
    SafetyInputParams,
    TiltParams,
    Use,
)
from robotctl.kernel.types import (
    Event,
    GuardedCommandReceived,
    LoopStalled,
    ModeRequested,
    SafetyInputReceived,
    ScanReceived,
    Twist,
)
from robotctl.messages.inputs import encode_twist
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.names import INFO_RECORD
from robotctl.testing.drives import BEGIN_NS, drive_requested
from robotctl.testing.hearing import BATTERY, ODOMETRY, SCAN, TOPICS, WANTED, safety_message
from tests.support.edited_recordings import Contents, Stored, edit, write_contents
from tests.support.heard_drives import heard_drive
from tests.tampering.edits import check_edited, entries_dropped


@cache
def heard() -> Contents:
    return heard_drive(6.0, snapshots_s=(0.0, 3.0))


CLEAR = (inf,) * 63


@cache
def scanned() -> Contents:
    """A drive with ten scans a second, in which something comes nearer behind the robot."""
    params = replace(KernelParams(), scan=ScanParams(use=Use.OPTIONAL))
    scans = [
        ScanReceived(BEGIN_NS + 50_000_000 + number * 100_000_000, (9.0 - number / 10.0, *CLEAR))
        for number in range(50)
    ]
    requests: list[Event] = [*scans, drive_requested()]
    return heard_drive(6.0, requests=requests, config=Config(kernel=params))


@cache
def guarded() -> Contents:
    """Ten wanted velocities a second, one of them not finite."""
    wanted: list[Event] = [
        GuardedCommandReceived(
            BEGIN_NS + 250_000_000 + number * 100_000_000,
            Twist(nan if number == 20 else number / 200.0, 0.1),
        )
        for number in range(50)
    ]
    asked = ModeRequested(BEGIN_NS + 200_000_000, 1, Mode.MOVING.value, "planner")
    config = Config(kernel=replace(KernelParams(), guard=True))
    return heard_drive(6.0, requests=[asked, *wanted], config=config)


@cache
def drives() -> dict[str, Contents]:
    """The recordings by the inputs that they hold."""
    return {ODOMETRY: heard(), BATTERY: heard(), SCAN: scanned(), WANTED: guarded()}


@pytest.mark.parametrize(
    ("topic", "count"), [(ODOMETRY, 301), (BATTERY, 6), (SCAN, 50), (WANTED, 50)]
)
def test_what_was_heard_and_recorded_is_the_same(tmp_path: Path, topic: str, count: int) -> None:
    report = check_edited(tmp_path, drives()[topic])
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert drives()[topic].counts[topic] == count


def moved(data: bytes) -> bytes:
    """Move odometry by 100 m."""
    at_x = len(data) - 36 * 8 - 6 * 8 - 36 * 8 - 7 * 8
    (x,) = struct.unpack_from("<d", data, at_x)
    return data[:at_x] + struct.pack("<d", x + 100.0) + data[at_x + 8 :]


def nearer(data: bytes) -> bytes:
    """Change the first range of a scan without a frame name."""
    at = 4 + 16 + 7 * 4 + 4
    return data[:at] + struct.pack("<f", 0.5) + data[at + 4 :]


def test_losses_that_were_counted_are_a_note(tmp_path: Path) -> None:
    edited = edit(heard(), ODOMETRY, lambda at, each: None if at in range(50, 60) else each)
    edited.lose(ODOMETRY, 10)
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.SAME
    assert "10 were counted as lost" in report.notes[0]


@pytest.mark.parametrize(
    ("count", "closed", "verdict"),
    [(8, False, Verdict.SAME), (8, True, Verdict.BROKEN), (120, False, Verdict.INCOMPLETE)],
)
def test_the_first_messages_may_lack_where_no_losses_are_known(
    tmp_path: Path, count: int, closed: bool, verdict: Verdict
) -> None:
    """The recorder finds a publisher later than the control loop; 120 messages take 2.4 s."""
    source = heard() if closed else heard().unclosed()
    edited = edit(source, ODOMETRY, lambda at, each: each if at >= count else None)
    report = check_edited(tmp_path, edited)
    assert report.verdict is verdict, report


@pytest.mark.parametrize(("stalled_s", "verdict"), [(0.0, "incomplete"), (0.3, "same")])
def test_a_stall_before_the_end_holds_up_the_last_messages(
    tmp_path: Path, stalled_s: float, verdict: str
) -> None:
    stall = LoopStalled(BEGIN_NS + 2_900_000_000, stalled_s, 0, 0, "the machine was busy")
    requests: list[Event] = [drive_requested(), stall]
    contents = heard_drive(3.0, requests=requests).unclosed()
    end_ns = contents.messages[-1].log_ns
    edited = edit(
        contents, ODOMETRY, lambda at, each: None if end_ns - each.log_ns < 7 * 10**8 else each
    )
    assert check_edited(tmp_path, edited).verdict.value == verdict


@pytest.mark.parametrize(("count", "verdict"), [(5, Verdict.SAME), (40, Verdict.BROKEN)])
def test_the_first_messages_of_a_later_file_may_be_in_the_file_before(
    tmp_path: Path, count: int, verdict: Verdict
) -> None:
    """After a stall the recorder takes many messages, and begins a file, before they are heard."""
    later = heard().copy()
    del later.messages[: heard().snapshots()[1]]
    first = next(each.sequence for each in later.messages if each.topic == ODOMETRY)
    edited = edit(later, ODOMETRY, lambda at, each: None if each.sequence < first + count else each)
    (file,) = write_contents(tmp_path / "run", edited).glob("*.mcap")
    report = check_recording(file.rename(file.with_name("run_1.mcap")))
    assert report.verdict is verdict, report


def test_a_flood_of_messages_that_were_not_heard_is_no_violation(tmp_path: Path) -> None:
    edited = heard().copy()
    at = [i for i, each in enumerate(edited.messages) if each.topic == ODOMETRY][2]
    last = edited.messages[at]
    edited.messages[at + 1 : at + 1] = [
        replace(last, sequence=last.sequence + 100_000 + number) for number in range(20_000)
    ]
    report = check_edited(tmp_path, edited)
    assert (report.verdict, report.violations) == (Verdict.SAME, [])


STOPS = {
    SafetyInput.ESTOP: 1.0,
    SafetyInput.JOY: 1.0,
    SafetyInput.BUMPER: 1.0,
    SafetyInput.TILT: 0.5,
    SafetyInput.DIAGNOSTICS: 2.0,
}
"""What each input says from message 30 on."""

WITH_VALUE = pytest.mark.parametrize(
    "kind", [each for each in SafetyInput if each is not SafetyInput.DIAGNOSTICS]
)


def detail_of(kind: SafetyInput) -> str:
    return "motor: warm" if kind is SafetyInput.DIAGNOSTICS else ""


@cache
def pressed() -> Contents:
    """A drive with ten messages a second of each input, each of which stops the robot after 3 s."""
    inputs = SafetyInputParams(
        EstopParams(Use.OPTIONAL),
        JoyParams(Use.OPTIONAL),
        BumperParams(Use.OPTIONAL),
        TiltParams(Use.OPTIONAL),
        DiagnosticsParams(Use.OPTIONAL),
    )
    requests: list[Event] = [drive_requested()]
    for number in range(50):
        t_ns = BEGIN_NS + 50_000_000 + number * 100_000_000
        for kind, value in STOPS.items():
            said = value if number >= 30 else 0.0
            requests.append(SafetyInputReceived(t_ns, kind, said, detail_of(kind)))
    config = Config(kernel=replace(KernelParams(), inputs=inputs))
    return heard_drive(6.0, requests=requests, config=config, snapshots_s=(0.0, 3.05))


def changed(
    contents: Contents, kind: SafetyInput, change: Callable[[Stored], Stored | None]
) -> Contents:
    return edit(contents, TOPICS[kind], lambda at, each: change(each))


def without_events(contents: Contents, kind: SafetyInput, numbers: Container[int]) -> Contents:
    """Return the contents without the events of these messages, as best effort may lose them."""

    def is_lost(entry: JournalEntry) -> bool:
        values = json.loads(entry.data) if entry.name == "SafetyInputReceived" else {"kind": None}
        return values["kind"] == kind.value and values["sequence"] in numbers

    return entries_dropped(is_lost)(contents, Random(1))


def test_the_recorded_messages_say_what_the_journal_holds(tmp_path: Path) -> None:
    report = check_edited(tmp_path, pressed())
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert [pressed().counts[topic] for topic in TOPICS.values()] == [50] * 5


@WITH_VALUE
def test_a_change_that_the_journal_never_saw_is_named(tmp_path: Path, kind: SafetyInput) -> None:
    other = safety_message(kind, STOPS[kind], detail_of(kind))
    edited = without_events(pressed(), kind, range(5, 15))
    edited = changed(edited, kind, lambda m: replace(m, data=other) if 5 <= m.sequence < 15 else m)
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.INCOMPLETE
    assert "the journal does not hold messages 5 to 11 of the " in str(report.missing)


@WITH_VALUE
def test_equal_messages_need_not_be_events(tmp_path: Path, kind: SafetyInput) -> None:
    """The control loop hands on each changed value, and equal ones four times in the timeout."""
    rest = range(8, 28)
    edited = pressed()
    for number in rest:
        if number % 2:
            edited = without_events(edited, kind, range(number, number + 1))
    report = check_edited(tmp_path, edited)
    assert (report.verdict, report.notes) == (Verdict.SAME, [])


def test_an_unreadable_message_is_an_input_too(tmp_path: Path) -> None:
    estop = replace(SafetyInputParams().estop, use=Use.OPTIONAL)
    inputs = replace(SafetyInputParams(), estop=estop)
    config = Config(kernel=replace(KernelParams(), inputs=inputs))
    requests: list[Event] = [
        SafetyInputReceived(BEGIN_NS + n * 100_000_000, SafetyInput.ESTOP, nan) for n in (1, 2, 3)
    ]
    contents = heard_drive(2.0, requests=requests, config=config)
    assert check_edited(tmp_path, contents).verdict is Verdict.SAME


@pytest.mark.parametrize("text", ["fast", "nan", "1e400", ""])
def test_a_parameter_that_is_no_number_fails_no_check(tmp_path: Path, text: str) -> None:
    edited = pressed().copy()
    for name, values in edited.metadata:
        if name == INFO_RECORD:
            values["parameter.inputs.joy.button"] = text
            values["parameter.inputs.estop.timeout_s"] = text
    assert check_edited(tmp_path, edited).verdict is not Verdict.BROKEN


def test_messages_that_are_recorded_late_were_heard(tmp_path: Path) -> None:
    """A busy recorder takes them up to a second after the control loop, also over a snapshot."""
    topic, late = TOPICS[SafetyInput.ESTOP], 10**9
    edited = pressed().copy()
    edited.messages = sorted(
        (replace(m, log_ns=m.log_ns + late) if m.topic == topic else m for m in pressed().messages),
        key=lambda each: each.log_ns,
    )
    end_ns = pressed().messages[-1].log_ns
    edited.messages = [m for m in edited.messages if m.topic != topic or m.log_ns <= end_ns]
    edited.lose(topic, 20)
    assert check_edited(tmp_path, edited).verdict is Verdict.SAME


def test_a_gap_in_which_nothing_could_be_heard_does_not_count(tmp_path: Path) -> None:
    """A process that was stopped receives only the last messages of its queue."""
    topic = TOPICS[SafetyInput.ESTOP]
    edited = without_events(pressed(), SafetyInput.ESTOP, {20, 28})
    edited.messages = [m for m in edited.messages if m.topic != topic or m.sequence <= 20]
    edited.messages += [m for m in pressed().messages if m.topic == topic and m.sequence >= 28]
    edited.messages.sort(key=lambda each: each.log_ns)
    edited = without_events(edited, SafetyInput.ESTOP, set(range(21, 28)))
    edited.lose(topic, 7)
    assert check_edited(tmp_path, edited).verdict is Verdict.SAME


def one_bit_flipped(data: bytes) -> bytes:
    """Change the last bit of a battery level."""
    return data[:-4] + bytes([data[-4] ^ 1]) + data[-3:]


@pytest.mark.parametrize("topic", [ODOMETRY, BATTERY, SCAN, WANTED])
def test_messages_that_were_removed_are_missed(tmp_path: Path, topic: str) -> None:
    edited = edit(drives()[topic], topic, lambda at, each: each if at not in (2, 3) else None)
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith("2 messages of ")
    assert ", message 3" in report.violations[0].text


@pytest.mark.parametrize(
    ("topic", "change", "name"),
    [
        (ODOMETRY, moved, "odometry"),
        (BATTERY, one_bit_flipped, "the battery"),
        (SCAN, nearer, "the scan"),
        (WANTED, lambda data: encode_twist(Twist(0.01, 0.1)), "the wanted velocity"),
    ],
)
def test_a_message_that_was_changed_is_found(
    tmp_path: Path, topic: str, change: Callable[[bytes], bytes], name: str
) -> None:
    edited = edit(
        drives()[topic], topic, lambda n, m: replace(m, data=change(m.data)) if n == 4 else m
    )
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith(
        f"1 messages are not what the control loop received as {name}"
    )


@WITH_VALUE
def test_a_press_that_was_changed_is_found(tmp_path: Path, kind: SafetyInput) -> None:
    released = safety_message(kind, 0.0, detail_of(kind))
    edited = changed(pressed(), kind, lambda m: replace(m, data=released) if m.sequence > 30 else m)
    report = check_edited(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN


def test_a_message_that_is_repeated_is_missed(tmp_path: Path) -> None:
    edited = heard().copy()
    at = next(i for i, each in enumerate(edited.messages) if each.topic == ODOMETRY) + 200
    repeated = next(each for each in edited.messages[at:] if each.topic == ODOMETRY)
    edited.messages.insert(at + 60, repeated)
    assert check_edited(tmp_path, edited).verdict is Verdict.INCOMPLETE
