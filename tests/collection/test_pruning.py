"""What is removed here: only what retention ends and the store was seen to hold."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from robotctl.collection import sync
from robotctl.collection.sources import Pace
from robotctl.collection.sync import GIVE_UP_AFTER, Pruned
from robotctl.recording.disk.storage import DiskFile
from robotctl.recording.keep.listing import set_kept
from robotctl.recording.keep.retention import NOTES_FILE, RetentionPolicy
from robotctl.recording.keep.tidy_job import TidyJob, tidy
from robotctl.store import StoreFailed
from tests.collection.conftest import FIRST, SECOND, Run, copy_as
from tests.support.memory_store import MemoryStore

ALL = RetentionPolicy(max_bytes=0, max_age_s=None)
NOW_S = 2e9


@pytest.fixture
def collected(run: Run, recordings: Path) -> Path:
    run()
    return recordings


def prune(
    recordings: Path,
    store: MemoryStore,
    policy: RetentionPolicy,
    now_s: float,
    pace: Pace = lambda count: None,
) -> Pruned:
    """Remove recordings after a run that has left out none of the first two."""
    return sync.prune(recordings, store, policy, now_s, complete=(FIRST, SECOND), pace=pace)


def names(pruned: Pruned) -> list[str]:
    return [each.path.name for each in pruned.removed]


def data_key(store: MemoryStore, recording: str) -> str:
    (key,) = (key for key in store.objects if key.endswith(f"{recording}_0.mcap"))
    return key


def test_what_is_in_the_store_is_removed_with_its_folder(
    collected: Path, store: MemoryStore
) -> None:
    before = dict(store.objects)
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == [f"{FIRST}_0.mcap", f"{SECOND}_0.mcap"]
    assert not list(collected.glob("robot_*"))
    assert store.objects == before


def test_the_next_daemon_that_tidies_tells_what_was_removed(
    collected: Path, store: MemoryStore
) -> None:
    removed = prune(collected, store, ALL, NOW_S).removed
    notes = list(tidy(TidyJob(collected, RetentionPolicy(), repairs=False)))
    assert [each.removed for each in notes] == [str(each.path) for each in removed]
    assert "its copy to memory was read" in notes[0].text


def test_a_removal_that_cannot_be_noted_is_not_made(collected: Path, store: MemoryStore) -> None:
    (collected / NOTES_FILE).mkdir()
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == []
    assert "its removal cannot be noted" in pruned.problems[0]


def test_a_removal_that_fails_is_named_and_its_note_is_taken_back(
    collected: Path, store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink = Path.unlink

    def fails(self: Path, missing_ok: bool = False) -> None:
        if self.name == f"{FIRST}_0.mcap":
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        unlink(self, missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", fails)
        pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert pruned.problems == [
        f"{FIRST}_0.mcap is kept: it cannot be removed: Operation not permitted"
    ]
    (collected / FIRST / f"{FIRST}_0.mcap").unlink()  # later, by a user
    notes = list(tidy(TidyJob(collected, RetentionPolicy(), repairs=False)))
    assert [Path(each.removed).name for each in notes] == [f"{SECOND}_0.mcap"]


def test_a_file_that_another_process_removes_first_is_not_noted(
    collected: Path, store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink = Path.unlink

    def removed_twice(self: Path, missing_ok: bool = False) -> None:
        unlink(self, missing_ok)
        if self.suffix == ".mcap":
            unlink(self)

    monkeypatch.setattr(Path, "unlink", removed_twice)
    assert prune(collected, store, ALL, NOW_S) == Pruned()
    assert list(tidy(TidyJob(collected, RetentionPolicy(), repairs=False))) == []


def test_what_retention_does_not_end_stays(collected: Path, store: MemoryStore) -> None:
    set_kept(collected / FIRST, kept=True)
    writing = DiskFile(collected / SECOND / f"{SECOND}_0.mcap", new=False)
    try:
        assert names(prune(collected, store, ALL, NOW_S)) == []
    finally:
        writing.close()
    young = RetentionPolicy(max_bytes=None, max_age_s=NOW_S)
    assert names(prune(collected, store, young, NOW_S)) == []


def test_a_recording_that_was_never_copied_stays(
    collected: Path, store: MemoryStore, one_recording: Path
) -> None:
    other = copy_as(one_recording, collected / "robot_20260103_120000")
    pruned = prune(collected, store, ALL, NOW_S)
    assert len(pruned.removed) == 2
    assert pruned.problems == [
        f"{other.name}_0.mcap is kept: its recording is not completely in the store"
    ]
    assert (other / f"{other.name}_0.mcap").exists()


@pytest.mark.parametrize("kind", ["same size", "shorter", "longer"])
def test_an_object_that_was_changed_is_named_and_its_file_stays(
    collected: Path, store: MemoryStore, kind: str
) -> None:
    key = data_key(store, FIRST)
    content = store.objects[key]
    changed = {"same size": content[:-1] + b"X", "shorter": content[:-1], "longer": content + b"X"}
    store.objects[key] = changed[kind]
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert key in pruned.wrong[0]
    assert "has other content than the file here" in pruned.wrong[0]
    assert (collected / FIRST / f"{FIRST}_0.mcap").exists()


def test_an_object_that_has_vanished_is_named_and_its_file_stays(
    collected: Path, store: MemoryStore
) -> None:
    del store.objects[data_key(store, FIRST)]
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert pruned.problems == [f"{FIRST}_0.mcap is kept: it is not in the store"]
    assert (collected / FIRST / f"{FIRST}_0.mcap").exists()


def test_a_store_that_sends_too_little_removes_nothing(
    collected: Path, store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = store.get_range
    monkeypatch.setattr(store, "get_range", lambda found, *ends: whole(found, *ends)[:-1])
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == []
    assert len(pruned.wrong) == 2


def test_a_file_that_has_changed_since_it_was_copied_stays(
    collected: Path, store: MemoryStore
) -> None:
    data = collected / FIRST / f"{FIRST}_0.mcap"
    data.write_bytes(data.read_bytes()[:-1] + b"X")
    pruned = prune(collected, store, ALL, NOW_S)
    assert names(pruned) == [f"{SECOND}_0.mcap"]
    assert "has other content than the file here" in pruned.wrong[0]


def test_a_store_that_is_away_is_not_asked_for_every_file(
    collected: Path, store: MemoryStore, one_recording: Path
) -> None:
    days = [f"robot_202601{day}_120000" for day in range(10, 28)]
    for name in days:
        copy_as(one_recording, collected / name)

    def away(request: str, key: str) -> None:
        raise StoreFailed("memory: it refuses the connection")

    store.before = away
    store.requests.clear()
    pruned = sync.prune(collected, store, ALL, NOW_S, complete=days)
    assert names(pruned) == []
    assert len(store.requests) == GIVE_UP_AFTER
