"""Whatever becomes of a clip, the daemon goes on; and it does not grow without bounds."""

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
from robotctl.daemon.recording import black_box
from robotctl.daemon.recording.black_box import CUTTER, BlackBox
from robotctl.processes import start
from robotctl.recording import Recorder
from robotctl.recording.format.events import EventKind, RecordedEvent
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import ClipJob
from tests.support.recordings import GID, TWIST, numbered
from tests.support.waiting import DEADLINE_S, until

SAY = """
import os, sys
def say(text):
    os.write(int(sys.argv[-1]), f"{text}\\n".encode())
"""

NOW = RecordedEvent(EventKind.ERROR, 0, "because")
PARAMS = RecordingParams(clip_before_s=1.0, clip_after_s=0.0)


@pytest.fixture
def cutter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Put a program in the place of the cutter; returns the file into which it may write."""

    def put(program: str) -> Path:
        log = tmp_path / "log"
        program = f"log = open({str(log)!r}, 'a')\n{SAY}{program}"
        monkeypatch.setattr(black_box, "CUTTER", (sys.executable, "-c", program))
        return log

    return put


async def cut(*events: RecordedEvent, params: RecordingParams = PARAMS) -> None:
    box = BlackBox(params, Path("/nowhere"))
    for event in events:
        box.note(event)
    await box.finish()


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ('say(\'{"error": "the disk is full"}\')', "the disk is full"),
        ("raise SystemExit('it broke')", "its process ended with 1 and said nothing of it"),
        ("say('nonsense')", "no clip was cut of the error"),
        ("say('[1]')", "no clip was cut of the error"),
        ("pass", "its process ended with 0 and said nothing of it"),
        ('say(\'{"target": "a.mcap", "lost": ["a chunk"]}\')', "it lacks something: a chunk"),
    ],
)
async def test_a_cutter_that_fails_is_told_in_the_log_and_nowhere_else(
    program: str,
    said: str,
    cutter: Callable[[str], Path],
    caplog: pytest.LogCaptureFixture,
) -> None:
    cutter(program)
    await cut(NOW)
    assert said in caplog.text


async def test_no_clip_is_cut_of_what_is_no_fault_or_where_it_is_switched_off(
    cutter: Callable[[str], Path],
) -> None:
    log = cutter("log.write('cut\\n')")
    await cut(RecordedEvent(EventKind.MARK, 0, ""), RecordedEvent(EventKind.DRIVE_ENDED, 0, ""))
    await cut(NOW, params=RecordingParams(clip_before_s=0.0))
    assert not log.exists()
    await cut(NOW)
    assert log.read_text() == "cut\n"


async def test_more_than_a_few_do_not_wait_and_that_is_said(
    cutter: Callable[[str], Path], caplog: pytest.LogCaptureFixture
) -> None:
    log = cutter("log.write('cut\\n')")
    await cut(*[NOW] * 20)
    assert log.read_text().count("cut") == black_box.MAX_WAITING
    assert caplog.text.count("there are too many") == 20 - black_box.MAX_WAITING


async def test_a_life_has_a_limit_of_clips(
    cutter: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(black_box, "MAX_CLIPS", 3)
    log = cutter("log.write('cut\\n')")
    box = BlackBox(PARAMS, Path("/nowhere"))
    for _ in range(5):
        box.note(NOW)
        await box.finish()
    assert log.read_text().count("cut") == 3


async def test_each_is_cut_when_its_time_has_come_and_none_twice(
    cutter: Callable[[str], Path],
) -> None:
    log = cutter("log.write('cut\\n')")
    box = BlackBox(RecordingParams(clip_before_s=1.0, clip_after_s=600.0), Path("/nowhere"))
    running = asyncio.create_task(box.run())
    box.note(RecordedEvent(EventKind.ERROR, 0, "long ago"))
    await asyncio.to_thread(until, lambda: box._cutting is not None and box._cutting.done())
    assert log.read_text() == "cut\n"
    box.note(RecordedEvent(EventKind.EMERGENCY_STOP, time.time_ns(), "now"))
    for _ in range(5):
        await asyncio.sleep(0)
    assert len(box._waiting) == 1
    running.cancel()
    await asyncio.wait({running})
    await box.finish()
    assert log.read_text() == "cut\ncut\n"


async def test_a_clock_that_is_set_back_does_not_hold_up_a_clip(
    cutter: Callable[[str], Path],
) -> None:
    log = cutter("log.write('cut\\n')")
    box = BlackBox(RecordingParams(clip_before_s=1.0, clip_after_s=0.1), Path("/nowhere"))
    in_an_hour_ns = time.time_ns() + 3600 * 10**9
    box.note(RecordedEvent(EventKind.ERROR, in_an_hour_ns, "before the clock was set back"))
    running = asyncio.create_task(box.run())
    await asyncio.to_thread(until, lambda: log.exists() and log.read_text() == "cut\n")
    running.cancel()
    await asyncio.wait({running})
    await box.finish()


async def test_a_cutter_that_hangs_is_ended(
    cutter: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(black_box, "END_DEADLINE_S", 0.2)
    monkeypatch.setattr(black_box, "PATIENCE_S", 0.2)
    cutter("import time\ntime.sleep(600)")
    await cut(NOW, NOW)
    assert "its process took longer than 0 s" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING


def test_the_cutter_has_the_lowest_priority(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    moment = Moment(time.time_ns(), EventKind.ERROR)
    job = ClipJob(tmp_path / "run", moment, 1.0, 600.0)
    cutter = start([*CUTTER, job.to_json()])
    try:
        until(lambda: os.getpriority(os.PRIO_PROCESS, cutter.pid) == 19)
        now_ns = time.time_ns()
        recorder.write(recorder.add_topic(TWIST), numbered(1), now_ns, now_ns, 1, GID)
        recorder.close()
        said = cutter.hear_one(DEADLINE_S)
    finally:
        recorder.close()
        cutter.close()
    assert said["target"].startswith(str(tmp_path / "run" / "clips"))


async def test_what_the_cutter_writes_stands_in_the_daemons_log(
    cutter: Callable[[str], Path], capfd: pytest.CaptureFixture[str]
) -> None:
    cutter("print('to stdout', flush=True)\nraise SystemExit('it broke')")
    await cut(NOW)
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("to stdout\nit broke\n")
