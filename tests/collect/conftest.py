"""Recordings to collect, and a store in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.collect.collecting import Collected, collect
from robotctl.collect.hash_ledger import hash_ledger
from robotctl.testing.drives import drive, record
from tests.support.memory_store import MemoryStore

FIRST, SECOND = "robot_20260101_120000", "robot_20260102_120000"

Collect = Callable[[], Collected]


@pytest.fixture(scope="session")
def one_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("collect") / FIRST, drive(0.3))


def copy_as(recording: Path, folder: Path) -> Path:
    """Copy a recording under the name of `folder`, with other data, as one of an hour ago."""
    folder.mkdir(parents=True)
    an_hour_ago_s = time.time() - 3600
    for path in recording.iterdir():
        copied = folder / path.name.replace(recording.name, folder.name)
        copied.write_bytes(path.read_bytes() + folder.name.encode())
        os.utime(copied, (an_hour_ago_s, an_hour_ago_s))
    return folder


@pytest.fixture
def recordings(one_recording: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "recordings"
    for name in (FIRST, SECOND):
        copy_as(one_recording, folder / name)
    return folder


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


@pytest.fixture
def run(recordings: Path, store: MemoryStore) -> Collect:
    """Return a function that does what a run of the command does."""

    def collect_once() -> Collected:
        with hash_ledger(recordings, time.time_ns) as ledger:
            return collect(recordings, store, ledger)

    return collect_once
