"""The safety inputs of a journal are the recorded messages, and no change of them is left out."""

from __future__ import annotations

import json
from collections.abc import Callable, Container
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from robotctl.config import Config
from robotctl.kernel.params import KernelParams
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
from robotctl.kernel.types import Event, SafetyInputReceived
from robotctl.recording.format.journal import decode
from robotctl.recording.format.names import INFO_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import BEGIN_NS, drive_requested
from robotctl.testing.hearing import TOPICS, safety_message
from tests.support.edited_recordings import Contents, Stored, edit, write_contents
from tests.support.heard_drives import JOURNAL, heard_drive
from tests.tampering.edits import journal

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


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Contents:
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
    requests.sort(key=lambda event: event.t_ns)
    config = Config(kernel=replace(KernelParams(), inputs=inputs))
    folder = tmp_path_factory.mktemp("pressed") / "run"
    return heard_drive(folder, 6.0, requests=requests, config=config, snapshots_s=(0.0, 3.05))


def check(tmp_path: Path, contents: Contents) -> Report:
    return check_recording(write_contents(tmp_path / "run", contents))


def changed(
    contents: Contents, kind: SafetyInput, change: Callable[[Stored], Stored | None]
) -> Contents:
    return edit(contents, TOPICS[kind], lambda at, each: change(each))


def heard(entry_name: str, data: str, kind: SafetyInput) -> bool:
    return entry_name == "SafetyInputReceived" and json.loads(data)["kind"] == kind.value


def without_events(contents: Contents, kind: SafetyInput, numbers: Container[int]) -> Contents:
    """Return the contents without the events of these messages, as best effort may lose them."""
    gone = {
        at
        for at, each in enumerate(e for e in contents.messages if e.topic == JOURNAL)
        if heard((entry := decode(each.data)).name, entry.data, kind)
        and json.loads(entry.data)["sequence"] in numbers
    }
    return journal(
        lambda entries, _: [None if at in gone else each for at, each in enumerate(entries)],
        careful=True,
    )(contents, None)  # type: ignore[arg-type]


def test_the_recorded_messages_say_what_the_journal_holds(
    tmp_path: Path, pressed: Contents
) -> None:
    report = check(tmp_path, pressed)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert [pressed.counts[topic] for topic in TOPICS.values()] == [50] * 5


@WITH_VALUE
def test_a_message_that_was_changed_is_found(
    tmp_path: Path, pressed: Contents, kind: SafetyInput
) -> None:
    released = safety_message(kind, 0.0, detail_of(kind))
    edited = changed(pressed, kind, lambda m: replace(m, data=released) if m.sequence > 30 else m)
    report = check(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN


@WITH_VALUE
def test_a_change_that_the_journal_never_saw_is_named(
    tmp_path: Path, pressed: Contents, kind: SafetyInput
) -> None:
    other = safety_message(kind, STOPS[kind], detail_of(kind))
    edited = without_events(pressed, kind, range(5, 15))
    edited = changed(edited, kind, lambda m: replace(m, data=other) if 5 <= m.sequence < 15 else m)
    report = check(tmp_path, edited)
    assert report.verdict is Verdict.INCOMPLETE
    assert "the journal does not hold messages 5 to 11 of the " in str(report.missing)


@WITH_VALUE
def test_equal_messages_need_not_be_events(
    tmp_path: Path, pressed: Contents, kind: SafetyInput
) -> None:
    """The control loop hands on each changed value, and equal ones four times in the timeout."""
    rest = range(8, 28)
    edited = pressed
    for number in rest:
        if number % 2:
            edited = without_events(edited, kind, range(number, number + 1))
    report = check(tmp_path, edited)
    assert (report.verdict, report.notes) == (Verdict.SAME, [])


def test_an_unreadable_message_is_an_input_too(tmp_path: Path) -> None:
    estop = replace(SafetyInputParams().estop, use=Use.OPTIONAL)
    inputs = replace(SafetyInputParams(), estop=estop)
    config = Config(kernel=replace(KernelParams(), inputs=inputs))
    requests: list[Event] = [
        SafetyInputReceived(BEGIN_NS + n * 100_000_000, SafetyInput.ESTOP, nan) for n in (1, 2, 3)
    ]
    contents = heard_drive(tmp_path / "made", 2.0, requests=requests, config=config)
    assert check(tmp_path, contents).verdict is Verdict.SAME


@pytest.mark.parametrize("text", ["fast", "nan", "1e400", ""])
def test_a_parameter_that_is_no_number_fails_no_check(
    tmp_path: Path, pressed: Contents, text: str
) -> None:
    edited = pressed.copy()
    for name, values in edited.metadata:
        if name == INFO_RECORD:
            values["parameter.inputs.joy.button"] = text
            values["parameter.inputs.estop.timeout_s"] = text
    assert check(tmp_path, edited).verdict is not Verdict.BROKEN


def test_messages_that_are_recorded_late_were_heard(tmp_path: Path, pressed: Contents) -> None:
    """A busy recorder takes them up to a second after the control loop, also over a snapshot."""
    topic, late = TOPICS[SafetyInput.ESTOP], 10**9
    edited = pressed.copy()
    edited.messages = sorted(
        (replace(m, log_ns=m.log_ns + late) if m.topic == topic else m for m in pressed.messages),
        key=lambda each: each.log_ns,
    )
    end_ns = pressed.messages[-1].log_ns
    edited.messages = [m for m in edited.messages if m.topic != topic or m.log_ns <= end_ns]
    edited.lose(topic, 20)
    assert check(tmp_path, edited).verdict is Verdict.SAME


def test_a_gap_in_which_nothing_could_be_heard_does_not_count(
    tmp_path: Path, pressed: Contents
) -> None:
    """A process that was stopped receives only the last messages of its queue."""
    topic, edited = TOPICS[SafetyInput.ESTOP], without_events(pressed, SafetyInput.ESTOP, {20, 28})
    edited.messages = [m for m in edited.messages if m.topic != topic or m.sequence <= 20]
    edited.messages += [m for m in pressed.messages if m.topic == topic and m.sequence >= 28]
    edited.messages.sort(key=lambda each: each.log_ns)
    edited = without_events(edited, SafetyInput.ESTOP, set(range(21, 28)))
    edited.lose(topic, 7)
    assert check(tmp_path, edited).verdict is Verdict.SAME
