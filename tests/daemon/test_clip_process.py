"""The daemon survives any failure of a clip, and limits the number of clips."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.config import RecordingParams
from robotctl.daemon.recording.black_box import DEFAULT_LIMITS, BlackBox, ClipLimits, clip_command
from robotctl.kernel.units import NS_PER_S
from robotctl.processes import start
from robotctl.recording import Recorder
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import ClipJob
from robotctl.testing.drives import GID, TWIST
from tests.support.recordings import numbered
from tests.support.waiting import DEADLINE_S, loop_until, until

SAY = """
import os, sys
def say(text):
    os.write(int(sys.argv[-1]), f"{text}\\n".encode())
"""

NOW = RecordedEvent(EventKind.ERROR, 0, "because")
PARAMS = RecordingParams(clip_before_s=1.0, clip_after_s=0.0)
WRITE = "log.write('cut\\n')"

Log = Callable[[], str]
Cutter = Callable[[str], tuple[str, ...]]


@pytest.fixture
def log(tmp_path: Path) -> Log:
    """Return what the programs in the place of the clip process have written so far."""
    path = tmp_path / "log"
    return lambda: path.read_text() if path.exists() else ""


@pytest.fixture
def cutter(tmp_path: Path) -> Cutter:
    """Return the command of a Python program that takes the place of the clip process."""
    return lambda program: (
        sys.executable,
        "-c",
        f"log = open({str(tmp_path / 'log')!r}, 'a')\n{SAY}{program}",
    )


async def cut(
    cutter: tuple[str, ...],
    *events: RecordedEvent,
    params: RecordingParams = PARAMS,
    limits: ClipLimits = DEFAULT_LIMITS,
) -> None:
    box = BlackBox(params, Path("/nowhere"), command=lambda job: cutter, limits=limits)
    for event in events:
        box.note(event)
    await box.finish()


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ('say(\'{"error": "the disk is full"}\')', "the disk is full"),
        ("raise SystemExit('it broke')", "its process ended with 1"),
        ("say('nonsense')", "no clip was cut of the error"),
        ("say('[1]')", "no clip was cut of the error"),
        ("pass", "its process made no report"),
        ('say(\'{"target": "a.mcap", "lost": ["a chunk"]}\')', "the clip is incomplete: a chunk"),
    ],
)
async def test_a_failed_clip_process_is_only_logged(
    program: str,
    said: str,
    cutter: Cutter,
    caplog: pytest.LogCaptureFixture,
) -> None:
    await cut(cutter(program), NOW)
    assert said in caplog.text


async def test_no_clip_is_cut_of_what_is_no_fault_or_where_it_is_switched_off(
    cutter: Cutter, log: Log
) -> None:
    kinds = (EventKind.MARK, EventKind.DRIVE_ENDED)
    await cut(cutter(WRITE), *(RecordedEvent(kind, 0, "") for kind in kinds))
    await cut(cutter(WRITE), NOW, params=RecordingParams(clip_before_s=0.0))
    assert log() == ""
    await cut(cutter(WRITE), NOW)
    assert log() == "cut\n"


async def test_more_than_a_few_waiting_clips_are_refused_and_logged(
    cutter: Cutter, log: Log, caplog: pytest.LogCaptureFixture
) -> None:
    await cut(cutter(WRITE), *[NOW] * 20, limits=ClipLimits(waiting=3))
    assert log().count("cut") == 3
    assert caplog.text.count("the limit is reached") == 17


async def test_a_run_has_a_limit_of_clips(cutter: Cutter, log: Log) -> None:
    limits = ClipLimits(clips=3)
    box = BlackBox(PARAMS, Path("/nowhere"), command=lambda job: cutter(WRITE), limits=limits)
    for _ in range(5):
        box.note(NOW)
        await box.finish()
    assert log().count("cut") == 3


async def test_each_clip_is_cut_once_when_its_time_has_passed(cutter: Cutter, log: Log) -> None:
    params = RecordingParams(clip_before_s=1.0, clip_after_s=600.0)
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)
        if seconds > 0:
            await asyncio.Event().wait()

    box = BlackBox(
        params,
        Path("/nowhere"),
        command=lambda job: cutter(WRITE),
        now_ns=lambda: 1000 * NS_PER_S,
        sleep=sleep,
    )
    box.note(RecordedEvent(EventKind.ERROR, 0, "1000 s ago"))
    box.note(RecordedEvent(EventKind.EMERGENCY_STOP, 900 * NS_PER_S, "100 s ago"))
    running = asyncio.create_task(box.run())
    await loop_until(lambda: len(slept) == 2)
    assert slept == [-400.0, 500.0]
    assert log() == "cut\n"
    running.cancel()
    await asyncio.wait({running})
    await box.finish()
    assert log() == "cut\ncut\n"


async def test_a_clock_that_is_set_back_does_not_hold_up_a_clip(cutter: Cutter) -> None:
    params = RecordingParams(clip_before_s=1.0, clip_after_s=0.1)
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    box = BlackBox(
        params, Path("/nowhere"), command=lambda job: cutter(WRITE), now_ns=lambda: 0, sleep=sleep
    )
    box.note(RecordedEvent(EventKind.ERROR, 3600 * NS_PER_S, "before the clock was set back"))
    running = asyncio.create_task(box.run())
    await loop_until(lambda: bool(slept))
    assert slept == [0.1]
    running.cancel()
    await asyncio.wait({running})
    await box.finish()


async def test_a_clip_process_that_hangs_is_ended(
    cutter: Cutter, caplog: pytest.LogCaptureFixture
) -> None:
    limits = ClipLimits(end_s=0.2, patience_s=0.2)
    await cut(cutter("import time\ntime.sleep(600)"), NOW, NOW, limits=limits)
    assert "its process took longer than 0 s" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING


def test_the_clip_process_has_the_lowest_priority(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    moment = Moment(time.time_ns(), EventKind.ERROR)
    job = ClipJob(tmp_path / "run", moment, 1.0, 600.0)
    cutter = start(clip_command(job))
    try:
        until(lambda: os.getpriority(os.PRIO_PROCESS, cutter.pid) == 19)
        now_ns = time.time_ns()
        recorder.write(recorder.add_topic(TWIST), numbered(1), now_ns, now_ns, 1, GID)
        recorder.close()
        said = cutter.receive_one(DEADLINE_S)
    finally:
        recorder.close()
        cutter.close()
    assert said["target"].startswith(str(tmp_path / "run" / "clips"))


async def test_the_output_of_the_clip_process_is_in_the_daemons_log(
    cutter: Cutter, capfd: pytest.CaptureFixture[str]
) -> None:
    await cut(cutter("print('to stdout', flush=True)\nraise SystemExit('it broke')"), NOW)
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("to stdout\nit broke\n")
