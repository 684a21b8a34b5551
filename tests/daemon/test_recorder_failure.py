"""A failed recorder is reported everywhere, and stops the robot if so configured."""

from __future__ import annotations

import logging
import resource
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.recording import recordings_folder, topic_rates
from robotctl.errors import UnreadableFile
from robotctl.kernel.patterns import PatternKind
from robotctl.recording import RecorderOptions, Recording, read_journal
from robotctl.rerun.rerun import first_divergence
from robotctl.testing.faults import FailingFile
from tests.support.waiting import until
from tests.support.world import PATIENT, World, journal_of, read_back

NEVER = 1 << 60
MORE_BYTES = 60_000


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


def is_moving(status: Any) -> bool:
    return bool(status["mode"] == "MOVING" and status["velocity"]["linear"] > 0.02)


def has_failed(status: Any) -> bool:
    return bool(status["recorder"]["state"] == "failed")


async def test_the_robot_stops_when_nothing_is_recorded_any_more(
    in_process: Callable[..., Any], disk: list[FailingFile]
) -> None:
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await daemon.until(is_moving)
        disk[0].fail_now()
        status = await daemon.until(lambda status: status["mode"] == "ERROR")
        assert "No space left on device" in status["mode_reason"]
        assert has_failed(status)


async def test_the_robot_goes_on_when_it_is_only_to_warn(
    in_process: Callable[..., Any],
    disk: list[FailingFile],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
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
    in_process: Callable[..., Any], disk: list[FailingFile], caplog: pytest.LogCaptureFixture
) -> None:
    async with in_process(observe=True, sim=None) as daemon:
        disk[0].fail_now()
        status = await daemon.until(has_failed)
        assert any("No space left on device" in warning for warning in status["warnings"])
    assert "No space left on device" in caplog.text


async def test_a_heavy_topic_is_named_once_with_the_filter_that_leaves_it_out(
    in_process: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(topic_rates, "HEAVY_BYTES_PER_S", 1.0)
    monkeypatch.setattr(topic_rates, "HEAVY_WINDOW_S", 1.0)
    told = "robotctl start --exclude /battery_state leaves it out of the recording"
    async with in_process() as daemon:
        status = await daemon.until(
            lambda status: any(told in warning for warning in status["warnings"])
        )
        assert not any("/cmd_vel" in warning for warning in status["warnings"])
        sampled = status["uptime_s"] + 3.0
        await daemon.until(lambda status: status["uptime_s"] > sampled)
    assert caplog.text.count(told) == 1


def holds_a_journal(folder: Path) -> bool:
    try:
        with Recording(folder) as recording:
            return any(True for _ in read_journal(recording, on_missing=lambda part: None))
    except UnreadableFile:
        return False


def test_a_recorder_that_fails_stops_the_robot(world: World) -> None:
    world.ok("start", "--sim", "--drive", "circle", "--config", str(world.patient))
    # Not from the start: shared memory counts as a file as well, and the journal is to begin.
    (folder,) = world.recordings.iterdir()
    until(lambda: holds_a_journal(folder))
    most = sum(path.stat().st_size for path in folder.glob("*.mcap")) + MORE_BYTES
    resource.prlimit(world.status()["pid"], resource.RLIMIT_FSIZE, (most, most))
    until(lambda: world.status()["mode"] == "ERROR")
    status = world.status()
    assert status["recorder"]["state"] == "failed"
    assert "File too large" in status["mode_reason"]
    refused = world.robotctl("reset")
    assert refused.exit_code == 4
    recorder = world.status()["recorder"]
    assert recorder["received"] == recorder["written"] + recorder["queued"] + recorder["dropped"]
    world.ok("stop")
    journal = journal_of(read_back(folder)["/robotctl/journal"])
    assert first_divergence(journal) is None
