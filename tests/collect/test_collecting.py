"""What is copied to a store: everything, once, under its hash, and never half of it."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import time
from pathlib import Path

import pytest

from robotctl.collect.collecting import GIVE_UP_AFTER, collect
from robotctl.collect.hash_ledger import hash_ledger
from robotctl.collect.object_names import ObjectName
from robotctl.errors import AlreadyRunning
from robotctl.store import StoreFailed
from tests.collect.conftest import (
    FIRST,
    SECOND,
    Collect,
    contents,
    copy_as,
    files_here,
    stored_files,
    writing,
)
from tests.support.memory_store import MemoryStore, works


class Killed(BaseException):
    """What ends a run at once, as a signal does."""


def test_every_file_is_stored_under_its_hash_and_named_by_a_manifest(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    (recordings / FIRST / "clips").mkdir()
    shutil.copy(recordings / FIRST / f"{FIRST}_0.mcap", recordings / FIRST / "clips" / "a.mcap")
    done = run()
    assert (done.complete, done.problems, done.wrong) == ([FIRST, SECOND], [], [])
    for name in (FIRST, SECOND):
        assert stored_files(store, name) == files_here(recordings / name)
    for key, content in store.objects.items():
        name_of_it = ObjectName.parse(key)
        assert name_of_it is not None
        assert hashlib.sha256(content).hexdigest() == name_of_it.sha256


def test_a_second_run_sends_nothing_hashes_nothing_and_asks_once(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    store.requests.clear()
    with hash_ledger(recordings, time.time_ns) as ledger:
        done = collect(recordings, store, ledger)
    assert (done.complete, done.copied, ledger.hashed_bytes) == ([FIRST, SECOND], {}, 0)
    assert store.requests == [("list", "")]


def test_a_run_that_is_killed_at_any_request_goes_on_with_what_is_missing(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    whole = dict(store.objects)
    for number in range(1, len(whole) + 1):
        store.objects.clear()
        store.requests.clear()

        def killed(request: str, key: str, at: int = number) -> None:
            if len(store.puts()) == at:
                raise Killed

        store.before = killed
        with pytest.raises(Killed):
            run()
        store.before = works
        manifests = [each.manifest for each in contents(store).values()]
        for manifest in filter(None, manifests):
            assert stored_files(store, manifest.recording) == files_here(
                recordings / manifest.recording
            ), "a manifest is there before its files"
        there = len(store.objects)
        store.requests.clear()
        run()
        assert store.objects == whole
        assert len(store.puts()) == len(whole) - there, "an object was sent twice"


def test_a_store_that_fails_often_gets_everything_in_the_end(
    run: Collect, store: MemoryStore, recordings: Path, one_recording: Path
) -> None:
    for day in range(10, 28):
        copy_as(one_recording, recordings / f"robot_202601{day}_120000")
    chance = random.Random(17)

    def fails(request: str, key: str) -> None:
        if request != "list" and chance.random() < 0.05:
            raise StoreFailed("memory: the store answers with HTTP status 503")

    store.before = fails
    first = run()
    assert 0 < len(first.problems) == 20 - len(first.complete)
    assert all("HTTP status 503" in said for said in first.problems)
    for _ in range(5):
        last = run()
    store.before = works
    assert (len(last.complete), last.problems) == (20, [])
    for folder in recordings.glob("robot_*"):
        assert stored_files(store, folder.name) == files_here(folder)


def test_a_store_that_is_away_is_not_asked_for_every_recording(
    run: Collect, store: MemoryStore, recordings: Path, one_recording: Path
) -> None:
    for day in range(10, 28):
        copy_as(one_recording, recordings / f"robot_202601{day}_120000")

    def away(request: str, key: str) -> None:
        if request == "put":
            raise StoreFailed("memory: it refuses the connection")

    store.before = away
    done = run()
    assert len(store.puts()) == GIVE_UP_AFTER
    assert "the rest is left for later" in done.problems[-1]


def test_of_a_recording_that_is_being_made_the_finished_files_are_there(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    folder = recordings / SECOND
    shutil.copy(folder / f"{SECOND}_0.mcap", folder / f"{SECOND}_1.mcap")
    data = files_here(folder)
    with writing(folder / f"{SECOND}_1.mcap"):
        done = run()
    assert (done.complete, done.live) == ([FIRST], [SECOND])
    assert stored_files(store, SECOND) == {f"{SECOND}_0.mcap": data[f"{SECOND}_0.mcap"]}
    assert run().complete == [FIRST, SECOND]
    assert stored_files(store, SECOND) == data


def test_what_retention_takes_from_a_recording_that_goes_on_is_in_its_last_manifest(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    folder = recordings / SECOND
    data = {}
    for number in range(1, 4):
        new = folder / f"{SECOND}_{number}.mcap"
        shutil.copy(folder / f"{SECOND}_{number - 1}.mcap", new)
        data[new.name] = new.read_bytes()
        with writing(new):
            run()
        (folder / f"{SECOND}_{number - 1}.mcap").unlink()
    assert run().problems == []
    there = stored_files(store, SECOND)
    assert {name: there[name] for name in data} == data
    assert len([name for name in there if name.endswith(".mcap")]) == 4


def test_a_file_that_is_written_while_it_is_copied_is_named_and_not_stored(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    store.objects.clear()
    data = recordings / FIRST / f"{FIRST}_0.mcap"
    stamp = data.stat()
    data.write_bytes(data.read_bytes()[:-1] + b"X")
    os.utime(data, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    first = run()
    assert first.complete == [SECOND]
    assert "was written while it was copied" in first.problems[0]
    assert not any(key.endswith(data.name) and FIRST in key for key in store.objects)
    assert contents(store)[FIRST].manifest is None
    assert run().complete == [FIRST, SECOND]
    assert stored_files(store, FIRST) == files_here(recordings / FIRST)


def test_an_index_that_is_made_later_follows_in_a_second_manifest(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    (recordings / FIRST / "index.parquet").write_bytes(b"an index")
    done = run()
    assert [file.name for file in done.copied[FIRST]] == ["index.parquet"]
    assert stored_files(store, FIRST) == files_here(recordings / FIRST)
    newest = contents(store)[FIRST].manifest
    assert newest is not None
    assert newest.manifest_number == 2
    assert run().copied == {}


def test_what_retention_has_removed_here_stays_in_the_manifest(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    shutil.copy(recordings / FIRST / f"{FIRST}_0.mcap", recordings / FIRST / f"{FIRST}_1.mcap")
    run()
    before = dict(store.objects)
    (recordings / FIRST / f"{FIRST}_0.mcap").unlink()
    (recordings / FIRST / "metadata.yaml").write_text("rewritten for the files that are left")
    assert run().problems == []
    assert store.objects == before
    shutil.rmtree(recordings / SECOND)
    assert run().complete == [FIRST]
    assert store.objects == before


def test_an_object_that_has_vanished_is_copied_again(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    whole = dict(store.objects)
    (gone,) = (key for key in whole if key.endswith(f"{FIRST}_0.mcap"))
    del store.objects[gone]
    assert [file.name for file in run().copied[FIRST]] == [f"{FIRST}_0.mcap"]
    assert store.objects == whole


def test_a_file_that_is_neither_here_nor_there_any_more_is_named(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    shutil.copy(recordings / FIRST / f"{FIRST}_0.mcap", recordings / FIRST / f"{FIRST}_1.mcap")
    run()
    (recordings / FIRST / f"{FIRST}_0.mcap").unlink()
    (gone,) = (key for key in store.objects if key.endswith(f"{FIRST}_0.mcap"))
    del store.objects[gone]
    done = run()
    assert done.problems == [f"{FIRST}: {FIRST}_0.mcap is neither here nor in the store any more"]


def test_an_object_of_another_size_than_its_name_says_is_named_and_left(
    run: Collect, store: MemoryStore
) -> None:
    run()
    (changed,) = (key for key in store.objects if key.endswith(f"{FIRST}_0.mcap"))
    store.objects[changed] = b"short"
    done = run()
    assert done.complete == [SECOND]
    assert changed in done.wrong[0]
    assert store.objects[changed] == b"short"


def test_a_manifest_that_was_changed_is_named(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    there = contents(store)[FIRST].manifest
    assert there is not None
    store.objects[there.key] = b"{}"
    (recordings / FIRST / "index.parquet").write_bytes(b"an index")
    done = run()
    assert there.key in done.wrong[0]


def test_no_link_leads_a_copy_elsewhere(run: Collect, store: MemoryStore, recordings: Path) -> None:
    secret = recordings.parent / "secret"
    secret.write_text("a private key")
    for name in ("metadata.yaml", "index.parquet"):
        (recordings / FIRST / name).unlink(missing_ok=True)
        (recordings / FIRST / name).symlink_to(secret)
    (recordings / FIRST / f"{FIRST}_1.mcap").symlink_to(secret)
    (recordings / "linked_20260101_120000").symlink_to(recordings / SECOND)
    run()
    assert b"a private key" not in store.objects.values()
    assert set(contents(store)) == {FIRST, SECOND}


def test_a_name_that_not_every_store_can_hold_is_named(
    run: Collect, store: MemoryStore, recordings: Path, one_recording: Path
) -> None:
    copy_as(one_recording, recordings / "a\x1b[31m b")
    done = run()
    assert done.complete == [FIRST, SECOND]
    assert "is left out" in done.problems[0]
    assert "\x1b" not in done.problems[0]


def test_a_ledger_with_torn_and_odd_lines_costs_only_time(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    ledger = recordings / ".sync" / "hashes.jsonl"
    lines = ledger.read_bytes().splitlines(keepends=True)
    ledger.write_bytes(b"".join([b"[1]\n", b"\xff\n", b"[" * 99_999 + b"\n", *lines])[:-9])
    whole = dict(store.objects)
    store.objects.clear()
    assert run().problems == []
    assert store.objects == whole


def test_a_full_disk_here_does_not_keep_recordings_from_the_store(
    run: Collect, recordings: Path
) -> None:
    (recordings / ".sync").write_text("in the way of the folder of hashes")
    assert run().complete == [FIRST, SECOND]
    assert run().complete == [FIRST, SECOND]


def test_two_runs_at_once_are_one(run: Collect, recordings: Path) -> None:
    with hash_ledger(recordings, time.time_ns), pytest.raises(AlreadyRunning):
        run()


def test_a_month_of_recordings_is_looked_through_with_one_listing(
    store: MemoryStore, one_recording: Path, tmp_path: Path
) -> None:
    month = tmp_path / "month"
    for number in range(240):
        copy_as(one_recording, month / f"robot_202601{number // 10:02}_12000{number % 10}")
    with hash_ledger(month, time.time_ns) as ledger:
        assert len(collect(month, store, ledger).complete) == 240
    files = len(list(one_recording.iterdir()))
    assert len(store.requests) == 1 + 240 * (files + 1)
    store.requests.clear()
    with hash_ledger(month, time.time_ns) as ledger:
        assert len(collect(month, store, ledger).complete) == 240
    assert store.requests == [("list", "")]
