"""Copies to a bucket that fails often: S3 of another maker, which loses requests and answers."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.collection.sources import local_recordings
from robotctl.collection.sync import copy_recordings, prune
from robotctl.recording.keep.retention import RetentionPolicy
from robotctl.store import PART_BYTES, open_store
from tests.collection.conftest import FIRST, copy_as, files_below
from tests.support.memory_store import content
from tests.support.s3_server import Application, Failing, environment, s3_server

pytest.importorskip("obstore", reason="URLs are an extra: robotctl[store]")

LARGE = 2 * PART_BYTES + 1000


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Failing]]:
    made: list[Failing] = []

    def within(application: Application) -> Application:
        made.append(Failing(application))
        return made[0]

    with s3_server(within) as endpoint:
        for name, value in environment(endpoint).items():
            monkeypatch.setenv(name, value)
        yield made


def test_a_bucket_that_fails_often_holds_everything_before_anything_is_removed(
    failing: list[Failing], recordings: Path, one_recording: Path
) -> None:
    for day in range(10, 28):
        copy_as(one_recording, recordings / f"robot_202601{day}_120000")
    large = recordings / FIRST / f"{FIRST}_0.mcap"
    large.write_bytes(large.read_bytes() + os.urandom(LARGE))
    here = files_below(recordings)
    store = open_store("s3://robots/one")
    run = copy_recordings(local_recordings(recordings, time.time_ns()), store)
    assert (len(run.complete), run.problems, run.wrong) == (20, [], [])
    pruned = prune(recordings, store, RetentionPolicy(0, None), time.time(), complete=run.complete)
    assert (pruned.problems, pruned.wrong) == ([], [])
    assert not list(recordings.glob("robot_*"))
    there = {each.key: content(store, each.key) for each in store.list()}
    assert there == here
    for key, data in there.items():
        assert store.head(key).sha256 == hashlib.sha256(data).hexdigest()
    assert failing[0].requests > 150
    assert {"PUT", "PUT partNumber uploadId", "POST uploads", "GET", "HEAD"} <= failing[
        0
    ].kinds.keys()
    assert sum(failing[0].kinds.values()) >= 8
