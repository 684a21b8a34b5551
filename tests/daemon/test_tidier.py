"""The recordings folder is tidied in the background: no part of the daemon waits for it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.recording.tidier import TIDY
from robotctl.recording import Recorder, read_info
from robotctl.testing.drives import TWIST
from tests.support.recordings import write_numbered
from tests.support.waiting import until
from tests.support.world import World

_listeners: list[Callable[[str], None]] = []


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        for listener in _listeners:
            listener(os.fsdecode(arguments[0]))


@contextmanager
def opened_below(folder: Path) -> Iterator[list[Path]]:
    """The files that this process opens in a folder."""
    found: list[Path] = []

    def listen(name: str) -> None:
        if Path(name).is_relative_to(folder):
            found.append(Path(name))

    if not _listeners:
        sys.addaudithook(_hear)  # an audit hook cannot be removed
    _listeners.append(listen)
    try:
        yield found
    finally:
        _listeners[:] = [lambda name: None]


def torn(folder: Path) -> Path:
    """A recording without its end, as a crash leaves it."""
    recorder = Recorder(folder, on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 101))
    file = recorder.close().file
    os.truncate(file, file.stat().st_size - 20)
    return file


@contextmanager
def tidied_by_somebody(recordings: Path) -> Iterator[None]:
    """Another daemon that tidies the folder slowly."""
    folder = os.open(recordings, os.O_RDONLY)
    try:
        flock(folder, LOCK_EX)
        yield
    finally:
        os.close(folder)


def tidying(world: World) -> list[int]:
    found = world.processes().items()
    return [pid for pid, command in found if TIDY in command]


async def test_no_file_of_the_folder_is_opened_before_ready(
    in_process: Callable[..., Any], world: World
) -> None:
    files = [torn(world.recordings / f"robot_{number}") for number in range(5)]
    (world.recordings / "README").write_text("somebody's")
    with opened_below(world.recordings) as opened:
        async with in_process() as daemon:
            status = await daemon.ask("status")
            own = Path(status["recorder"]["file"]).parent
            assert own / status["recorder"]["file"] in opened
            assert {path for path in opened if not path.is_relative_to(own)} <= {world.recordings}
            await daemon.until(lambda status: str(status["warnings"]).count("torn") == len(files))
    assert [read_info(file).missing for file in files] == [()] * len(files)


def test_what_is_lost_is_in_the_status_and_what_is_well_in_the_log_only(world: World) -> None:
    file = torn(world.recordings / "robot_1")
    hopeless = torn(world.recordings / "robot_2")
    os.truncate(hopeless, 100)
    old = torn(world.recordings / "robot_0")
    os.utime(old, (0, 0))
    world.ok("start", "--sim")
    until(lambda: len(world.status()["warnings"]) >= 2)
    warnings = "\n".join(world.status()["warnings"])
    assert f"repaired: {file.name} was torn: " in warnings
    assert f"{hopeless.name} was torn and cannot be repaired" in warnings
    assert "removed" not in warnings
    assert f"removed for its age or to free space: {old}" in world.log()
    assert not old.exists()
    world.ok("stop")
    (journal,) = (world.folder / "state" / "robotctl" / "robot" / "decisions").iterdir()
    removed = [line for line in journal.read_text().splitlines() if '"kind":"removed"' in line]
    assert [json.loads(line)["file"] for line in removed] == [str(old)]


def test_start_and_stop_do_not_wait_for_another_process_that_tidies(world: World) -> None:
    file = torn(world.recordings / "robot_1")
    size = file.stat().st_size
    with tidied_by_somebody(world.recordings):
        world.ok("start", "--sim")
        until(lambda: tidying(world))
        world.ok("stop")
        assert tidying(world) == []
        assert file.stat().st_size == size
    assert "could not be tidied" not in world.log()


def test_a_stop_does_not_wait_for_the_retention_after_a_split(world: World) -> None:
    world.ok("start", "--sim")
    until(lambda: world.status()["recorder"]["written"] > 100)
    with tidied_by_somebody(world.recordings):
        world.ok("record", "split")
        until(lambda: tidying(world))
        world.ok("stop")
        assert tidying(world) == []


def test_a_folder_without_other_recordings_costs_no_process(world: World) -> None:
    world.ok("start", "--sim")
    until(lambda: world.status()["recorder"]["written"] > 100)
    assert tidying(world) == []
    world.ok("stop")
