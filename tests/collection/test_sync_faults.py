"""What sync must not lose: pruning, buckets that fail, processes that are killed."""

from __future__ import annotations

import errno
import hashlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.base.store import open_store
from robotctl.base.store.objects import PART_BYTES, StoreFailed
from robotctl.collection import sync
from robotctl.collection.sources import Pace, local_recordings
from robotctl.collection.sync import GIVE_UP_AFTER, Pruned, copy_recordings, prune
from robotctl.recording.format.disk import DiskFile
from robotctl.recording.keep.listing import set_kept
from robotctl.recording.keep.repair import TidyJob, tidy
from robotctl.recording.keep.retention import NOTES_FILE, RetentionPolicy
from tests.collection.conftest import FIRST, SECOND, Run, copy_as, files_below
from tests.support.stores import Application, Failing, MemoryStore, content, environment, s3_server
from tests.support.waiting import until

ALL = RetentionPolicy(max_bytes=0, max_age_s=None)
NOW_S = 2e9


@pytest.fixture
def collected(run: Run) -> Run:
    run()
    return run


def prune_two(run: Run, policy: RetentionPolicy = ALL, pace: Pace = lambda count: None) -> Pruned:
    """Remove recordings after a run that has left out none of the first two."""
    return sync.prune(run.recordings, run.store, policy, NOW_S, complete=(FIRST, SECOND), pace=pace)


def names(pruned: Pruned) -> list[str]:
    return [each.path.name for each in pruned.removed]


def data_key(store: MemoryStore, recording: str) -> str:
    (key,) = (key for key in store.objects if key.endswith(f"{recording}_0.mcap"))
    return key


def test_what_is_stored_is_removed_with_its_folder(collected: Run) -> None:
    before = dict(collected.store.objects)
    pruned = prune_two(collected)
    assert names(pruned) == [f"{FIRST}_0.mcap", f"{SECOND}_0.mcap"]
    assert not list(collected.recordings.glob("robot_*"))
    assert collected.store.objects == before


def test_the_next_daemon_tells_what_was_removed(collected: Run) -> None:
    removed = prune_two(collected).removed
    notes = list(tidy(TidyJob(collected.recordings, RetentionPolicy(), repairs=False)))
    assert [each.removed for each in notes] == [str(each.path) for each in removed]
    assert "its copy to memory was read" in notes[0].text


def test_a_removal_that_cannot_be_noted_is_not_made(collected: Run) -> None:
    (collected.recordings / NOTES_FILE).mkdir()
    pruned = prune_two(collected)
    assert names(pruned) == []
    assert "its removal cannot be noted" in pruned.problems[0]


def test_a_removal_that_fails_is_named_and_its_note_is_taken_back(
    collected: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink = Path.unlink

    def fails(self: Path, missing_ok: bool = False) -> None:
        if self.name == f"{FIRST}_0.mcap":
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        unlink(self, missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", fails)
        pruned = prune_two(collected)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert pruned.problems == [
        f"{FIRST}_0.mcap is kept: it cannot be removed: Operation not permitted"
    ]
    (collected.recordings / FIRST / f"{FIRST}_0.mcap").unlink()  # later, by a user
    notes = list(tidy(TidyJob(collected.recordings, RetentionPolicy(), repairs=False)))
    assert [Path(each.removed).name for each in notes] == [f"{SECOND}_0.mcap"]


def test_a_file_that_another_process_removes_first_is_not_noted(
    collected: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink = Path.unlink

    def removed_twice(self: Path, missing_ok: bool = False) -> None:
        unlink(self, missing_ok)
        if self.suffix == ".mcap":
            unlink(self)

    monkeypatch.setattr(Path, "unlink", removed_twice)
    assert prune_two(collected) == Pruned()
    assert list(tidy(TidyJob(collected.recordings, RetentionPolicy(), repairs=False))) == []


def test_what_retention_does_not_end_stays(collected: Run) -> None:
    set_kept(collected.recordings / FIRST, kept=True)
    writing = DiskFile(collected.recordings / SECOND / f"{SECOND}_0.mcap", new=False)
    try:
        assert names(prune_two(collected)) == []
    finally:
        writing.close()
    young = RetentionPolicy(max_bytes=None, max_age_s=NOW_S)
    assert names(prune_two(collected, young)) == []


def test_a_recording_that_was_never_copied_stays(collected: Run) -> None:
    other = collected.add("robot_20260103_120000")
    pruned = prune_two(collected)
    assert len(pruned.removed) == 2
    assert pruned.problems == [
        f"{other.name}_0.mcap is kept: its recording is not completely in the store"
    ]
    assert (other / f"{other.name}_0.mcap").exists()


@pytest.mark.parametrize("kind", ["same size", "shorter", "longer"])
def test_an_object_that_was_changed_is_named_and_its_file_stays(collected: Run, kind: str) -> None:
    key = data_key(collected.store, FIRST)
    content = collected.store.objects[key]
    changed = {"same size": content[:-1] + b"X", "shorter": content[:-1], "longer": content + b"X"}
    collected.store.objects[key] = changed[kind]
    pruned = prune_two(collected)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert key in pruned.wrong[0]
    assert "has other content than the file here" in pruned.wrong[0]
    assert (collected.recordings / FIRST / f"{FIRST}_0.mcap").exists()


def test_an_object_that_has_vanished_is_named_and_its_file_stays(collected: Run) -> None:
    del collected.store.objects[data_key(collected.store, FIRST)]
    pruned = prune_two(collected)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert pruned.problems == [f"{FIRST}_0.mcap is kept: it is not in the store"]
    assert (collected.recordings / FIRST / f"{FIRST}_0.mcap").exists()


def test_a_store_that_sends_too_little_removes_nothing(
    collected: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = collected.store.get_range
    monkeypatch.setattr(collected.store, "get_range", lambda found, *ends: whole(found, *ends)[:-1])
    pruned = prune_two(collected)
    assert names(pruned) == []
    assert len(pruned.wrong) == 2


def test_a_file_that_changed_since_it_was_copied_stays(collected: Run) -> None:
    data = collected.recordings / FIRST / f"{FIRST}_0.mcap"
    data.write_bytes(data.read_bytes()[:-1] + b"X")
    pruned = prune_two(collected)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert "has other content than the file here" in pruned.wrong[0]


def test_a_store_that_is_away_is_not_asked_for_every_file(collected: Run) -> None:
    days = [f"robot_202601{day}_120000" for day in range(10, 28)]
    for name in days:
        collected.add(name)

    def away(request: str, key: str) -> None:
        raise StoreFailed("memory: it refuses the connection")

    collected.store.before = away
    collected.store.requests.clear()
    pruned = sync.prune(collected.recordings, collected.store, ALL, NOW_S, complete=days)
    assert names(pruned) == []
    assert len(collected.store.requests) == GIVE_UP_AFTER


LARGE_BYTES = 2 * PART_BYTES + 1000


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
    for day in range(10, 18):
        copy_as(one_recording, recordings / f"robot_202601{day}_120000")
    large = recordings / FIRST / f"{FIRST}_0.mcap"
    large.write_bytes(large.read_bytes() + os.urandom(LARGE_BYTES))
    here = files_below(recordings)
    store = open_store("s3://robots/one")
    run = copy_recordings(local_recordings(recordings, time.time_ns()), store)
    assert (len(run.complete), run.problems, run.wrong) == (10, [], [])
    pruned = prune(recordings, store, RetentionPolicy(0, None), time.time(), complete=run.complete)
    assert (pruned.problems, pruned.wrong) == ([], [])
    assert not list(recordings.glob("robot_*"))
    there = {each.key: content(store, each.key) for each in store.list()}
    assert there == here
    for key, data in there.items():
        assert store.head(key).sha256 == hashlib.sha256(data).hexdigest()
    assert failing[0].requests > 60
    assert {"PUT", "PUT partNumber uploadId", "POST uploads", "GET", "HEAD"} <= failing[
        0
    ].kinds.keys()
    assert sum(failing[0].kinds.values()) >= 8


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
