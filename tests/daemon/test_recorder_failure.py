"""A recorder that cannot record is told or refused; one with nothing to record costs little."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import Refused
from robotctl.config import Config
from robotctl.daemon.recording import recorder_report, recordings_folder
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.kernel.patterns import PatternKind
from robotctl.recording import Recorder, RecorderOptions, read_info
from robotctl.ros.executor.runtime import Pool
from robotctl.testing.faults import FailingFile
from tests.daemon.conftest import is_moving
from tests.support.world import PATIENT, InProcess, World

NEVER = 1 << 60


@pytest.fixture
def disk(world: World, monkeypatch: pytest.MonkeyPatch) -> list[FailingFile]:
    """The files that a daemon in this process writes."""
    world.may_lack = "its disk fails"
    opened: list[FailingFile] = []

    def open_file(path: Path) -> FailingFile:
        opened.append(FailingFile(path, NEVER))
        return opened[-1]

    options = partial(RecorderOptions, open_file=open_file)
    monkeypatch.setattr(recordings_folder, "RecorderOptions", options)
    return opened


def has_failed(status: Any) -> bool:
    return bool(status["recorder"]["state"] == "failed")


async def test_the_robot_stops_when_nothing_is_recorded_any_more(
    in_process: InProcess, disk: list[FailingFile]
) -> None:
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        disk[0].fail_now()
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        assert "No space left on device" in status["mode_reason"]
        assert has_failed(status)
        with pytest.raises(Refused, match="No space left on device"):
            await daemon.ask("reset", source="test")
        told = (await daemon.ask("status"))["recorder"]
        assert told["received"] == told["written"] + told["queued"] + told["dropped"]


async def test_the_robot_goes_on_when_it_is_only_to_warn(
    in_process: InProcess, disk: list[FailingFile], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(f"{PATIENT}on_recorder_failure: warn\n")
    async with in_process(config=config, drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        disk[0].fail_now()
        status = await daemon.until(has_failed)
        assert any("No space left on device" in warning for warning in status["warnings"])
        await daemon.until(lambda later: later["recorder"]["dropped"] > 200)
        assert is_moving(await daemon.ask("status"))
        assert (await daemon.ask("set_mode", mode=0, source="test"))["mode"] == "IDLE"
        answer = await daemon.ask("set_mode", mode=1, source="test")
        assert answer["mode"] == "MOVING"  # then a recorder is no start condition
    errors = [record for record in caplog.records if record.levelno == logging.ERROR]
    assert [("No space left on device" in record.message) for record in errors] == [True]


async def test_an_observer_that_records_no_more_says_so(
    in_process: InProcess, disk: list[FailingFile], caplog: pytest.LogCaptureFixture
) -> None:
    async with in_process(observe=True, sim=None) as daemon:
        disk[0].fail_now()
        status = await daemon.until(has_failed)
        assert any("No space left on device" in warning for warning in status["warnings"])
    assert "No space left on device" in caplog.text


async def test_a_heavy_topic_is_named_once_with_the_filter_that_leaves_it_out(
    in_process: InProcess, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_report, "HEAVY_BYTES_PER_S", 1.0)
    monkeypatch.setattr(recorder_report, "HEAVY_WINDOW_S", 1.0)
    told = "robotctl start --exclude /battery_state leaves it out of the recording"
    async with in_process() as daemon:
        status = await daemon.until(
            lambda status: any(told in warning for warning in status["warnings"])
        )
        assert not any("/cmd_vel" in warning for warning in status["warnings"])
        sampled = status["uptime_s"] + 1.5
        await daemon.until(lambda status: status["uptime_s"] > sampled)
    assert caplog.text.count(told) == 1


LOOKS_PER_S = 100
"""Limit of the polls of the recorder's topics: a rest of one beat makes 50, of 2 ms 200."""


async def test_the_recorder_of_a_quiet_robot_looks_seldom(
    in_process: Callable[..., AbstractAsyncContextManager[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = 0
    loop = asyncio.get_running_loop()
    call_at = loop.call_at

    def counted(at_s: float, callback: Any, *arguments: Any, **named: Any) -> asyncio.TimerHandle:
        """A pool rests after each look."""
        nonlocal looks
        looks += isinstance(getattr(callback, "__self__", None), Pool)
        return call_at(at_s, callback, *arguments, **named)

    monkeypatch.setattr(loop, "call_at", counted)
    async with in_process() as daemon:
        await daemon.until(lambda status: status["recorder"]["received"] > 200)
        looks, begun = 0, time.monotonic()
        await asyncio.sleep(1.0)
        rate = looks / (time.monotonic() - begun)
    assert 0 < rate <= LOOKS_PER_S


def test_folders_are_made_and_a_name_that_steers_a_terminal_is_shown_escaped(world: World) -> None:
    recordings = "a/../b c/d/rec\n\x1b[2J\x1b[31mordings"
    (world.folder / "a").mkdir()
    said = world.ok("start", "--observe", "--recordings", recordings)
    said += world.ok("status") + world.ok("stop") + world.ok("logs")
    (recorded,) = (world.folder / recordings).iterdir()
    assert read_info(recorded).missing == ()
    assert r"rec\n\x1b[2J\x1b[31mordings" in said
    assert all(line.isprintable() for line in said.splitlines())
    assert "\x1b" not in world.log()


def unexpected(told: object) -> None:
    pytest.fail(str(told))


def opened(recordings: Path) -> Recorder:
    return open_recorder(
        recordings, "robot", Config(), lambda: "IDLE", unexpected, unexpected, unexpected
    )


@pytest.mark.parametrize(
    ("recordings", "why"),
    [
        ("file", "Not a directory"),
        ("file/below", "Not a directory"),
        ("dangling", "File exists"),
        ("/sys/robotctl-recordings", ""),  # where not even root can make a folder
    ],
)
def test_where_nothing_can_be_recorded_nothing_is_touched(
    tmp_path: Path, recordings: str, why: str
) -> None:
    (tmp_path / "file").write_text("somebody's")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(Refused, match=f"cannot record into .*{why}"):
        opened(tmp_path / recordings)
    assert (tmp_path / "file").read_text() == "somebody's"
    assert not (tmp_path / "nowhere").exists()


def test_where_nothing_can_be_recorded_nothing_is_started(world: World) -> None:
    (world.folder / "file").write_text("somebody's")
    err = world.robotctl("start", "--observe", "--recordings", "file/below").failed(4)
    assert err.startswith("robotctl: cannot record into ")
    assert "Not a directory" in err
    assert "choose another folder (--recordings)" in err
    assert world.processes() == {}


def test_a_link_with_the_name_of_the_new_recording_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda form: "20260101_120000")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    (recordings / "robot_20260101_120000").symlink_to(elsewhere)
    (recordings / "robot_20260101_120000-2").symlink_to(tmp_path / "nowhere")
    recorder = opened(recordings)
    assert recorder.close().file.parent == recordings / "robot_20260101_120000-3"
    assert list(elsewhere.iterdir()) == []
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("option", ["--include", "--exclude"])
def test_a_pattern_of_no_topic_is_refused_and_shown_escaped(world: World, option: str) -> None:
    for pattern in ("/a\n/b", "/\x1b[2J", "camera", "", "/a,", "type:", "/a b"):
        err = world.here("start", "--observe", option, pattern).failed(2)
        assert err.startswith(f"robotctl: {option}: ")
        assert "use a topic (/scan), a glob (/camera/*) or a type" in err
        assert err.rstrip("\n").isprintable()
    assert not world.recordings.exists()
