"""Control handles events in order, journals each, and carries out effects despite failures.

A reply is sent after the latch is on the disk, and a cure names the robot.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robotctl.base.errors import Refused
from robotctl.check.compare import first_divergence
from robotctl.daemon.api.status import StatusSource, recording_methods
from robotctl.daemon.api.warnings import Warnings
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.control import latch
from robotctl.daemon.control.dispatcher import Control, Journal, PendingRequests, UnsavedReply
from robotctl.daemon.control.effects import Effects
from robotctl.daemon.control.latch import Latch, LatchedStop
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.daemon.shutdown import send_zero, stand_still
from robotctl.ipc.answers import RobotFacts
from robotctl.ipc.method_params import MarkParams, NoParams
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveEnded,
    DriveReport,
    Effect,
    LatchEmergencyStop,
    ModeChanged,
    ModeRequested,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.recording import Recorder
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from robotctl.testing.kernels import moving
from tests.daemon.conftest import stats_of
from tests.support.waiting import loop_until


class Bench:
    """A Control whose effects a test can redirect."""

    def __init__(self, params: KernelParams | None = None, state: State | None = None) -> None:
        self.entries: list[JournalEntry] = []
        self.done: list[Effect] = []
        self.failures: list[str] = []
        self.do: Callable[[Effect], None] = self.done.append
        self.requests = PendingRequests()
        self.control = Control(
            Kernel(params or KernelParams(), state),
            Journal(lambda serialized, seq: self.entries.append(decode(serialized))),
            self.requests,
            lambda error, where: self.failures.append(where),
        )
        self.control.carry_out = lambda effect: self.do(effect)
        self.control.journal_snapshot(0)

    def answer(self, effect: Effect) -> None:
        """Carry out nothing but replies."""
        if isinstance(effect, Reply):
            self.requests.replies.settle(effect)

    @property
    def names(self) -> list[str]:
        """The names of the journal entries."""
        return [entry.name for entry in self.entries]

    def published(self) -> int:
        """Return the number of commands so far."""
        return self.names.count("PublishTwist")


def test_an_effect_is_journaled_after_it_was_carried_out() -> None:
    bench = Bench()
    seen: list[int] = []
    bench.do = lambda effect: seen.append(len(bench.entries))
    bench.control.dispatch(Tick(1))
    assert bench.names == ["Snapshot", "Tick", "PublishTwist"]
    assert seen == [2]


def test_a_snapshot_stands_in_the_journal_every_10_s() -> None:
    bench = Bench()
    for tick in range(1, 121):
        bench.control.dispatch(Tick(tick * 250_000_000))
    at_s = [entry.t_ns / 1e9 for entry in bench.entries if entry.kind is EntryKind.SNAPSHOT]
    assert at_s == [0.0, 10.0, 20.0, 30.0]
    assert first_divergence(bench.entries) is None


def test_what_an_effect_dispatches_waits_its_turn() -> None:
    bench = Bench()

    def carry_out(effect: Effect) -> None:
        if isinstance(effect, LatchEmergencyStop):
            bench.control.dispatch(Tick(2))

    bench.do = carry_out
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    assert bench.names[-3:] == ["Reply", "Tick", "PublishTwist"]
    assert first_divergence(bench.entries) is None


def test_the_effects_after_a_failed_one_are_carried_out() -> None:
    bench = Bench()

    def fail_to_publish(effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            raise OSError("no network")
        bench.done.append(effect)

    bench.do = fail_to_publish
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    latched, changed, reply = bench.done
    assert (type(latched), type(changed)) == (LatchEmergencyStop, ModeChanged)
    assert isinstance(reply, Reply)
    assert (reply.ok, reply.mode) == (False, Mode.EMERGENCY_STOP)
    assert reply.message.endswith("but PublishTwist failed: no network")
    assert first_divergence(bench.entries) is None


def test_a_lasting_failure_is_reported_once() -> None:
    bench = Bench()

    def fail(effect: Effect) -> None:
        raise OSError("no network")

    bench.do = fail
    for t_ns in range(1, 4):
        bench.control.dispatch(Tick(t_ns))
    assert bench.failures == ["PublishTwist failed: no network"]
    bench.do = bench.done.append
    bench.control.dispatch(Tick(4))
    bench.do = fail
    bench.control.dispatch(Tick(5))
    assert len(bench.failures) == 2


async def test_a_cancelled_request_is_removed() -> None:
    bench = Bench()
    bench.requests.replies.expect(1).cancel()
    bench.requests.replies.settle(Reply(1, True, "", Mode.IDLE))
    bench.do = bench.answer
    reply = await bench.control.request(ResetRequested(1, 2, "test"))
    assert (reply.request_id, reply.ok) == (2, True)
    await loop_until(lambda: not bench.requests.replies._waiting)


async def test_no_motion_begins_while_the_daemon_ends() -> None:
    bench = Bench()
    bench.do = bench.answer
    await stand_still(bench.control, bench.published)
    assert bench.names[-2:] == ["Tick", "PublishTwist"]
    reply = await bench.control.request(ModeRequested(time.monotonic_ns(), 1, 1, "test"))
    assert not reply.ok
    assert "the daemon is stopping" in reply.message
    assert first_divergence(bench.entries) is None


def test_the_journal_of_a_daemon_that_fails_tells_that_it_ends() -> None:
    bench, velocity = Bench(), SimpleNamespace(published=0)

    def publish(effect: Effect) -> None:
        velocity.published += isinstance(effect, PublishTwist)

    bench.do = publish
    send_zero(bench.control, cast(VelocityPublisher, velocity))
    assert bench.names[-3:] == ["FaultReported", "Tick", "PublishTwist"]
    assert '"cause":"daemon ends"' in bench.entries[-3].data


async def test_a_last_zero_that_fails_is_sent_again() -> None:
    bench, failures, sent = Bench(), iter([MemoryError()] * 3), []

    def publish(effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            for failure in failures:
                raise failure
            sent.append(effect.twist)

    bench.do = publish
    await stand_still(bench.control, lambda: len(sent))
    assert sent == [ZERO]


async def test_a_ramp_that_takes_too_long_is_cut() -> None:
    bench = Bench(moving().kernel.params, moving().state)
    bench.do = bench.answer
    assert bench.control.state.command != ZERO
    await stand_still(  # without ticks
        bench.control,
        bench.published,
        ramp_down_s=0.01,
        now_ns=lambda: bench.control.state.tick_t_ns or 0,
    )
    assert bench.control.state.mode is Mode.ERROR
    assert bench.control.state.command == ZERO
    assert first_divergence(bench.entries) is None


REPLY = Reply(1, True, "Mode changed to EMERGENCY_STOP", Mode.EMERGENCY_STOP)


class Recorded:
    """Records what the effects do."""

    def __init__(self, folder: Path) -> None:
        self.latch = Latch(folder / "emergency-stop")
        self.done: list[Any] = []
        self.noted: list[RecordedEvent] = []
        requests = PendingRequests()
        self.expect = requests.replies.expect
        self.carry_out = Effects(
            self.done.append, self.done.append, self.noted.append, self.latch, requests, "r2"
        ).carry_out


@pytest.fixture
async def recorded(tmp_path: Path) -> AsyncIterator[Recorded]:
    made = Recorded(tmp_path)
    yield made
    await made.latch.close()


async def test_a_stop_is_confirmed_when_it_is_on_the_disk(
    recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, write = threading.Event(), latch.write

    def write_slowly(path: Path, stop: LatchedStop) -> None:
        disk.wait()
        write(path, stop)

    monkeypatch.setattr(latch, "write", write_slowly)
    reply = recorded.expect(1)
    recorded.carry_out(LatchEmergencyStop("test"))
    recorded.carry_out(REPLY)
    assert not reply.done()
    disk.set()
    assert await reply == REPLY
    assert recorded.latch.read() == LatchedStop("test", Cause.OPERATOR_STOP)


async def test_the_latch_remembers_why_the_robot_stopped(recorded: Recorded) -> None:
    recorded.carry_out(LatchEmergencyStop("empty", Cause.BATTERY_LOW))
    await recorded.latch.close()
    assert recorded.latch.read() == LatchedStop("empty", Cause.BATTERY_LOW)


async def test_a_stop_that_could_not_be_saved_is_confirmed_with_that(
    recorded: Recorded, tmp_path: Path
) -> None:
    (tmp_path / "emergency-stop.new").mkdir()
    reply = recorded.expect(1)
    recorded.carry_out(LatchEmergencyStop("test"))
    recorded.carry_out(REPLY)
    answer = await reply
    assert isinstance(answer, UnsavedReply)
    assert answer.ok
    assert f"{REPLY.message}, but a restart would forget this stop: " in answer.message
    refused = recorded.expect(2)
    recorded.carry_out(Reply(2, False, "no", Mode.EMERGENCY_STOP))
    assert await refused == Reply(2, False, "no", Mode.EMERGENCY_STOP)


async def test_stops_errors_and_drive_ends_are_events_of_the_recording(recorded: Recorded) -> None:
    for mode in Mode:
        recorded.carry_out(ModeChanged(Mode.IDLE, mode, f"to {mode.name}"))
    report = DriveReport(2, 8.0, 0.01, 0.02, 0.005)
    recorded.carry_out(DriveEnded(1, True, "driven", report))
    recorded.carry_out(PublishTwist(Twist(0.1, 0.2)))
    recorded.carry_out(ReleaseEmergencyStop())
    kinds = [(event.kind, event.text) for event in recorded.noted]
    assert kinds == [
        (EventKind.ERROR, "to ERROR"),
        (EventKind.EMERGENCY_STOP, "to EMERGENCY_STOP"),
        (EventKind.DRIVE_ENDED, "driven"),
    ]
    assert recorded.done == [*Mode, Twist(0.1, 0.2)]


async def test_the_log_names_the_robot_in_a_cure(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    failed = ModeChanged(Mode.IDLE, Mode.ERROR, "no disk: see robotctl logs", Cause.RECORDER_FAILED)
    recorded.carry_out(failed)
    assert "IDLE -> ERROR: no disk: see robotctl logs --robot r2: restart after that" in caplog.text
    assert "robotctl start --robot r2" in caplog.text


FAILURE = "the recorder failed: see robotctl logs"
FAILURE_OF_R2 = f"{FAILURE} --robot r2"


FAILED = stats_of(failure=FAILURE)


@pytest.fixture
def recorder() -> FlightRecorder:
    source = cast(Recorder, SimpleNamespace(stats=lambda: FAILED))
    fake = SimpleNamespace(
        failure=FAILURE,
        report=RecorderReport(source, TopicFilter((), (), ()), "r2"),
        stats=lambda: FAILED,
        split=lambda: None,
        problems=list,
    )
    return cast(FlightRecorder, fake)


async def test_a_failed_recorder_names_the_robot_in_its_cure(recorder: FlightRecorder) -> None:
    methods = recording_methods(recorder, "r2")
    status: Any = await methods["record_status"].handler(NoParams())
    assert status["warnings"] == [FAILURE_OF_R2]
    commit: Any = await methods["record_commit"].handler(NoParams())
    assert commit["failure"] == FAILURE_OF_R2
    for name, params in (("record_split", NoParams()), ("mark", MarkParams("here", "test"))):
        with pytest.raises(Refused, match=f"{FAILURE_OF_R2}$"):
            await methods[name].handler(params)


def test_the_notes_of_a_start_name_the_robot_in_a_cure(recorder: FlightRecorder) -> None:
    robot: Any = SimpleNamespace(
        facts=lambda: dict.fromkeys(RobotFacts.__required_keys__), remedies=lambda: ()
    )
    options = DaemonOptions("r2", None, Path(), None, None, 0)
    warnings = Warnings("r2", recorder, None, [])
    source = StatusSource(options, recorder.report, robot, "", warnings)
    note = "moving is refused: no odometry: (robotctl status lists the topics)"
    (told,) = source.summary([note])["notes"]
    assert "(robotctl status --robot r2 lists the topics)" in told


def test_diagnostics_on_ros_name_the_robot_in_a_cure(recorder: FlightRecorder) -> None:
    assert recorder.report.diagnosis(FAILED, []).message == FAILURE_OF_R2
