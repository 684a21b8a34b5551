"""A process that copies recordings is killed or interrupted: objects are whole, and it goes on."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robotctl.store import open_store
from tests.collection.conftest import copy_as, files_below
from tests.support.memory_store import content
from tests.support.s3_server import environment
from tests.support.waiting import until

ROBOTCTL = (sys.executable, "-c", "from robotctl.cli.app import main; main()")
KILLS = 12

WHOLE = 40 * 2
"""Files of all recordings: data and `metadata.yaml` of each."""


def started(place: str, recordings: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start `robotctl sync`."""
    command = [*ROBOTCTL, "sync", place, "--recordings"]
    return subprocess.Popen(
        [*command, str(recordings), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def run_to_its_end(place: str, recordings: Path, *options: str) -> None:
    with started(place, recordings, *options) as process:
        assert process.wait(120) == 0


def check_whole(place: str, whole: dict[str, bytes]) -> int:
    """Check that what is there is whole; return the number of files."""
    store = open_store(place)
    found = {each.key: content(store, each.key) for each in store.list()}
    assert found.items() <= whole.items()
    return len(found)


def until_stored(place: str, count: int) -> None:
    """Wait until a run has stored at least `count` objects."""
    store = open_store(place)
    until(lambda: len(list(store.list())) >= count)


def until_left(recordings: Path, count: int) -> None:
    """Wait until at most `count` folders are left."""
    until(lambda: len(os.listdir(recordings)) <= count)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["folder", "bucket"])
def test_a_process_that_is_killed_at_any_moment_goes_on(
    one_recording: Path,
    s3_endpoint: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    kind: str,
) -> None:
    for name, value in environment(s3_endpoint).items():
        monkeypatch.setenv(name, value)
    root = str(tmp_path) if kind == "folder" else f"s3://robots/{tmp_path.name}"
    recordings = tmp_path / "recordings"
    for number in range(40):
        folder = copy_as(one_recording, recordings / f"robot_20260101_1200{number:02}")
        if number % 8 == 0:
            with (folder / f"{folder.name}_0.mcap").open("ab") as file:
                file.write(os.urandom(9 << 20))  # goes in two parts
    whole = files_below(recordings)
    run_to_its_end(f"{root}/whole", recordings)
    chance = random.Random(5)
    for number in range(KILLS):
        with started(f"{root}/{number}", recordings) as process:
            until_stored(f"{root}/{number}", chance.randrange(1, WHOLE // 2))
            process.kill()
        assert 0 < check_whole(f"{root}/{number}", whole) < WHOLE
    for number in range(KILLS):
        run_to_its_end(f"{root}/{number}", recordings)
        assert check_whole(f"{root}/{number}", whole) == WHOLE
    for left in (30, 20, 10):
        with started(f"{root}/whole", recordings, "--max-total-gb", "0") as process:
            until_left(recordings, left)
            process.kill()
    run_to_its_end(f"{root}/whole", recordings, "--max-total-gb", "0")
    assert not list(recordings.rglob("*.mcap"))
    assert check_whole(f"{root}/whole", whole) == WHOLE


def test_an_interrupt_ends_a_wait_at_once(one_recording: Path, tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    copy_as(one_recording, recordings / one_recording.name)
    with started(str(tmp_path / "store"), recordings, "--limit-mbps", "0.01") as process:
        until((tmp_path / "store").exists)
        begun_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        assert time.monotonic() - begun_s < 10, "it slept until the limit let it go on"
    assert not list((tmp_path / "store").rglob("*.mcap"))
