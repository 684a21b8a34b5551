"""A gate that is killed in the middle leaves its results and no process, and the next goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from robotctl.testing.drives import drive, record
from tests.support.waiting import until

COUNT = 8
FIRST = 2


def gate(folder: Path) -> list[str]:
    program = "from robotctl.cli.app import main; main()"
    return [sys.executable, "-c", program, "gate", "--in", str(folder), "--json"]


def stored(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the results by name, each with what changes if it is written again."""
    found = [(each.name, each.stat()) for each in (folder / ".gate").glob("*.json")]
    return {name: (status.st_ino, status.st_mtime_ns) for name, status in found}


def has_ended(process: psutil.Process) -> bool:
    """Return whether a process has ended, also if nothing has collected it yet."""
    try:
        return bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Recordings that take a while: one file under many names, which are part of the hash."""
    (file,) = record(tmp_path / "made", drive(8.0)).glob("*.mcap")
    for number in range(COUNT):
        recording = tmp_path / f"recordings/robot_{number:02}"
        recording.mkdir(parents=True)
        (recording / f"{recording.name}_0.mcap").hardlink_to(file)
    return tmp_path / "recordings"


def test_a_killed_gate_leaves_no_process_and_the_next_judges_only_what_is_left(
    folder: Path,
) -> None:
    process = subprocess.Popen(
        gate(folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        until(lambda: len(stored(folder)) >= FIRST)
        children = psutil.Process(process.pid).children(recursive=True)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        until(lambda: all(map(has_ended, children)))
    finally:
        process.kill()
        process.wait()
    before = stored(folder)
    assert FIRST <= len(before) < COUNT
    ran = subprocess.run(gate(folder), capture_output=True, text=True, check=True)
    answer = json.loads(ran.stdout)
    assert (answer["stored"], answer["counts"]["same"]) == (len(before), COUNT)
    after = stored(folder)
    assert len(after) == COUNT
    assert {name: after[name] for name in before} == before
