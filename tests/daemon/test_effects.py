"""Effects are carried out in order, and a reply is sent after the latch is on the disk."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.control import latch
from robotctl.daemon.control.dispatcher import PendingRequests, UnsavedReply
from robotctl.daemon.control.effects import Effects
from robotctl.daemon.control.latch import Latch, LatchedStop
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import (
    Cause,
    DriveEnded,
    DriveReport,
    LatchEmergencyStop,
    ModeChanged,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    Twist,
)
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent

REPLY = Reply(1, True, "Mode changed to EMERGENCY_STOP", Mode.EMERGENCY_STOP)


class World:
    """Records what the effects do."""

    def __init__(self, folder: Path) -> None:
        self.latch_path = folder / "emergency-stop"
        self.latch = Latch(self.latch_path)
        self.requests = PendingRequests()
        self.done: list[Any] = []
        self.noted: list[RecordedEvent] = []
        self.effects = Effects(
            self.done.append, self.done.append, self.noted.append, self.latch, self.requests, "r2"
        )


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


async def test_a_stop_is_confirmed_when_it_is_on_the_disk(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, write = threading.Event(), latch.write

    def write_slowly(path: Path, stop: LatchedStop) -> None:
        disk.wait()
        write(path, stop)

    monkeypatch.setattr(latch, "write", write_slowly)
    reply = world.requests.expect_reply(1)
    world.effects.carry_out(LatchEmergencyStop("test"))
    world.effects.carry_out(REPLY)
    assert not reply.done()
    disk.set()
    assert await reply == REPLY
    assert world.latch.read() == LatchedStop("test", Cause.OPERATOR_STOP)
    await world.latch.close()


async def test_the_latch_remembers_why_the_robot_stopped(world: World) -> None:
    world.effects.carry_out(LatchEmergencyStop("empty", Cause.BATTERY_LOW))
    await world.latch.close()
    assert world.latch.read() == LatchedStop("empty", Cause.BATTERY_LOW)


async def test_a_stop_that_could_not_be_saved_is_confirmed_with_that(world: World) -> None:
    (world.latch_path.with_suffix(".new")).mkdir()
    reply = world.requests.expect_reply(1)
    world.effects.carry_out(LatchEmergencyStop("test"))
    world.effects.carry_out(REPLY)
    answer = await reply
    assert isinstance(answer, UnsavedReply)
    assert answer.ok
    assert f"{REPLY.message}, but a restart would forget this stop: " in answer.message
    refused = world.requests.expect_reply(2)
    world.effects.carry_out(Reply(2, False, "no", Mode.EMERGENCY_STOP))
    assert await refused == Reply(2, False, "no", Mode.EMERGENCY_STOP)
    await world.latch.close()


async def test_stops_errors_and_drive_ends_are_events_of_the_recording(world: World) -> None:
    for mode in Mode:
        world.effects.carry_out(ModeChanged(Mode.IDLE, mode, f"to {mode.name}"))
    report = DriveReport(2, 8.0, 0.01, 0.02, 0.005)
    world.effects.carry_out(DriveEnded(1, True, "driven", report))
    world.effects.carry_out(PublishTwist(Twist(0.1, 0.2)))
    world.effects.carry_out(ReleaseEmergencyStop())
    kinds = [(event.kind, event.text) for event in world.noted]
    assert kinds == [
        (EventKind.ERROR, "to ERROR"),
        (EventKind.EMERGENCY_STOP, "to EMERGENCY_STOP"),
        (EventKind.DRIVE_ENDED, "driven"),
    ]
    assert world.done == [*Mode, Twist(0.1, 0.2)]
    await world.latch.close()


async def test_the_log_names_the_robot_in_a_cure(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    failed = ModeChanged(Mode.IDLE, Mode.ERROR, "no disk: see robotctl logs", Cause.RECORDER_FAILED)
    world.effects.carry_out(failed)
    assert "IDLE -> ERROR: no disk: see robotctl logs --robot r2: restart after that" in caplog.text
    assert "robotctl start --robot r2" in caplog.text
    await world.latch.close()
