"""What the control socket answers to whoever waits for the end of a drive."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from math import inf, nan
from typing import Any

import pytest

from robotctl.daemon.driving import DrivingMethods
from robotctl.errors import Refused, UsageError
from robotctl.ipc.params import DriveParams
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import DriveEnded, DriveReport, Reply

ENDED = DriveEnded(1, True, "drive finished: 1 lap", DriveReport(1, 4.0, 0.01, 0.02, 0.005))


class FakeControl:
    """Accepts a drive that has ended already, and is in some mode by now."""

    def __init__(self, ended: DriveEnded, mode: Mode) -> None:
        self.ended = ended
        self.state = State(mode=mode)

    def new_request_id(self) -> int:
        return self.ended.request_id

    def expect_end(self, request_id: int) -> asyncio.Future[DriveEnded]:
        end: asyncio.Future[DriveEnded] = asyncio.get_running_loop().create_future()
        end.set_result(self.ended)
        return end

    async def request(self, event: Any) -> Reply:
        return Reply(event.request_id, True, "Mode changed to MOVING", Mode.MOVING)


async def wait_for(ended: DriveEnded, mode: Mode, laps: int) -> Any:
    control: Any = FakeControl(ended, mode)
    motion: Any = None
    drive = DrivingMethods(control, motion, KernelParams()).table()["drive"].handler
    return await drive(DriveParams(pattern="square", source="test", laps=laps, wait=True))


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.MOVING, Mode.EMERGENCY_STOP])
async def test_a_completed_drive_is_told_as_one_whatever_somebody_did_since(mode: Mode) -> None:
    answer = await wait_for(ENDED, mode, laps=1)
    assert (answer["message"], answer["laps"]) == (ENDED.reason, 1)


async def test_a_drive_that_ended_early_is_refused_and_gives_its_numbers() -> None:
    with pytest.raises(Refused, match=r"ended after 1 laps: stopped") as refused:
        await wait_for(replace(ENDED, completed=False, reason="stopped"), Mode.IDLE, laps=2)
    assert refused.value.answer == {
        "message": "stopped",
        "mode": "IDLE",
        "laps": 1,
        "distance_m": 4.0,
        "cross_track_rms_m": 0.01,
        "cross_track_max_m": 0.02,
        "closure_m": 0.005,
    }


async def test_a_number_of_a_drive_that_is_not_known_can_be_told() -> None:
    report = DriveReport(0, 0.4, inf, inf, nan)
    ended = replace(ENDED, completed=False, reason="stopped", report=report)
    with pytest.raises(Refused) as refused:
        await wait_for(ended, Mode.IDLE, laps=2)
    assert json.dumps(refused.value.answer, allow_nan=False).count("null") == 3


@pytest.mark.parametrize("mode", [Mode.ERROR, Mode.EMERGENCY_STOP])
async def test_a_drive_without_end_that_a_fault_ends_is_refused(mode: Mode) -> None:
    ended = replace(ENDED, completed=False, reason="stopped")
    assert (await wait_for(ended, Mode.IDLE, laps=0))["message"] == "stopped"
    with pytest.raises(Refused):
        await wait_for(ended, mode, laps=0)


async def test_a_speed_above_the_configured_limit_is_refused_by_name() -> None:
    nobody: Any = None  # is asked
    drive = DrivingMethods(nobody, nobody, KernelParams()).table()["drive"].handler
    with pytest.raises(UsageError, match=r"5 m/s is above limits.linear_mps, 0.6 m/s: use at most"):
        await drive(DriveParams(pattern="circle", source="test", speed_mps=5.0))
    with pytest.raises(AttributeError):  # the kernel is asked
        await drive(DriveParams(pattern="circle", source="test", speed_mps=0.6))
