"""Many recordings are checked in parallel, and no process is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from robotctl.check import run as module
from robotctl.check.run import check_recording, check_recordings
from robotctl.testing.drives import drive, record
from tests.support.waiting import DEADLINE_S, until


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("many") / "run", drive(1.0))


@pytest.fixture(autouse=True)
def no_process_is_left() -> Iterator[None]:
    before = set(psutil.Process().children())
    yield
    until(lambda: not any(map(is_alive, {*psutil.Process().children()} - before)))


def is_alive(process: psutil.Process) -> bool:
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def _deadly(all_bytes: bool, path: Path) -> dict[str, Any]:
    if path.name == "deadly":
        os._exit(9)
    return check_recording(path).as_object()


def test_a_process_that_dies_costs_its_recording_alone(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_checked", _deadly)
    reports = check_recordings([tmp_path / "deadly", recording, recording])
    assert [report["verdict"] for report in reports] == ["incomplete", "same", "same"]
    assert reports[0]["missing"] == ["the process that checked it was killed"]


CHECKS = """
import sys
from pathlib import Path
from robotctl.check.run import check_recordings
check_recordings([Path(sys.argv[1])] * 200, lambda done, total: done and print(done, flush=True))
"""


def check_of(folder: Path, seconds: float) -> subprocess.Popen[bytes]:
    """Begin to check a long recording again and again."""
    long = record(folder / "long", drive(seconds))
    command = [sys.executable, "-c", CHECKS, str(long)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, process_group=0)


def test_an_interrupted_check_ends_its_processes(tmp_path: Path) -> None:
    checking = check_of(tmp_path, 120.0)
    parent = psutil.Process(checking.pid)
    workers: list[psutil.Process] = []

    def are_working() -> bool:
        workers[:] = parent.children()
        return len(workers) >= min(2, len(os.sched_getaffinity(0)))

    until(are_working)
    checking.send_signal(signal.SIGINT)
    _, told = checking.communicate(timeout=DEADLINE_S)
    assert checking.returncode != 0
    assert b"KeyboardInterrupt" in told
    until(lambda: not any(map(is_alive, workers)))


def test_a_killed_check_leaves_no_process_and_no_traceback_behind(tmp_path: Path) -> None:
    checking = check_of(tmp_path, 60.0)
    assert checking.stdout is not None
    checking.stdout.readline()
    workers = psutil.Process(checking.pid).children()
    checking.kill()
    _, told = checking.communicate(timeout=DEADLINE_S)
    assert b"Traceback" not in told
    until(lambda: not any(map(is_alive, workers)))
