"""Recordings to copy, and a store in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotctl.collection.sources import local_recordings
from robotctl.collection.sync import Synced, copy_recordings
from robotctl.recording.format.disk import DiskFile
from robotctl.testing.drives import drive, record
from tests.support.stores import MemoryStore

FIRST, SECOND = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture(scope="session")
def one_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("collection") / FIRST, drive(0.3))


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


class Run:
    """Does what a run of the command does, with these recordings and this store."""

    def __init__(self, recordings: Path, store: MemoryStore, one_recording: Path) -> None:
        self.recordings = recordings
        self.store = store
        self._one_recording = one_recording

    def __call__(self) -> Synced:
        return copy_recordings(local_recordings(self.recordings, time.time_ns()), self.store)

    def add(self, name: str) -> Path:
        """Add a recording of this name."""
        return copy_as(self._one_recording, self.recordings / name)


@pytest.fixture
def run(recordings: Path, store: MemoryStore, one_recording: Path) -> Run:
    return Run(recordings, store, one_recording)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Hold a file as its recorder does."""
    file = DiskFile(path, new=False)
    try:
        yield
    finally:
        file.close()


def files_below(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
