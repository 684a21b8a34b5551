"""What is copied: everything, once, as the recording lies, and never half of it."""

from __future__ import annotations

import errno
import hashlib
import os
import random
import shutil
import time
from contextlib import AbstractContextManager
from io import FileIO
from pathlib import Path

import pytest
from mcap.writer import Writer

from robotctl.base.errors import UnreadableFile
from robotctl.base.store import open_store
from robotctl.base.store.objects import Stamp, StoreFailed
from robotctl.collection import sources
from robotctl.collection.sources import (
    OF_THE_SYSTEM,
    PIECE_BYTES,
    YOUNG_NS,
    local_recordings,
    open_regular_file,
    stored_recordings,
)
from robotctl.collection.sync import GIVE_UP_AFTER, Synced, copy_recordings
from tests.collection.conftest import FIRST, SECOND, Run, files_below, writing
from tests.support.stores import MemoryStore, works

DATA = f"{FIRST}/{FIRST}_0.mcap"


def away(request: str, key: str) -> None:
    """Fail as a store that takes no object now."""
    if request == "put":
        raise StoreFailed("memory: it refuses the connection")


class Killed(BaseException):
    """What ends a run at once, as a signal does."""


def torn(recording: Path) -> Path:
    """Add a file to a recording whose header a crash has left empty."""
    data = (recording / f"{recording.name}_0.mcap").read_bytes()
    file = recording / f"{recording.name}_1.mcap"
    file.write_bytes(bytes(4) + data[4:])
    os.utime(file, (time.time() - 3600,) * 2)
    return file


def named(done: Synced, *words: str) -> bool:
    """Return whether one of the sentences holds all of these words."""
    return any(all(word in said for word in words) for said in done.problems)


def names(done: Synced) -> list[str]:
    return [file.name for file in done.copied]


def in_earlier_layout(recordings: Path, store: MemoryStore) -> None:
    """Store the recordings as RECORDING/SHA256/FILE with a manifest, as an earlier robotctl did."""
    for key, content in files_below(recordings).items():
        recording, _, file = key.partition("/")
        store.objects[f"{recording}/{hashlib.sha256(content).hexdigest()}/{file}"] = content
        store.objects[f"{recording}/{'0' * 64}/manifest-000001.json"] = b"{}"


def test_a_copy_lies_as_the_recording_lies_with_hash_and_time(run: Run) -> None:
    (run.recordings / FIRST / "clips").mkdir()
    shutil.copy(run.recordings / DATA, run.recordings / FIRST / "clips" / "a.mcap")
    done = run()
    assert (done.complete, done.problems, done.wrong) == ([FIRST, SECOND], [], [])
    assert run.store.objects == files_below(run.recordings)
    for key, content in run.store.objects.items():
        assert run.store.stamps[key].sha256 == hashlib.sha256(content).hexdigest()
        assert run.store.stamps[key].modified_ns == (run.recordings / key).stat().st_mtime_ns


def test_a_second_run_sends_nothing_reads_nothing_and_asks_once(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    run()
    run.store.requests.clear()
    monkeypatch.setattr(sources.LocalFile, "sha256", None)
    done = run()
    assert (done.complete, done.copied) == ([FIRST, SECOND], [])
    assert run.store.requests == [("list", "")]


def test_copies_in_the_earlier_layout_are_not_sent_again(run: Run) -> None:
    in_earlier_layout(run.recordings, run.store)
    for key in run.store.objects:
        run.store.stamps[key] = Stamp(modified_ns=time.time_ns())  # as a store does
    (run.recordings / "new.mcap").write_bytes((run.recordings / DATA).read_bytes())
    done = run()
    assert (done.complete, names(done)) == (["new", FIRST, SECOND], ["new.mcap"])


@pytest.mark.parametrize("layout", ["earlier", "as the recording"])
def test_copies_come_back_as_they_were(
    recordings: Path, store: MemoryStore, tmp_path: Path, layout: str
) -> None:
    there, back = tmp_path / "there", tmp_path / "back"
    if layout == "earlier":
        in_earlier_layout(recordings, store)
        for key, content in store.objects.items():
            open_store(str(there)).put_if_absent(key, [content])
    else:
        shutil.copytree(recordings, there)
    done = copy_recordings(stored_recordings(str(there)), open_store(str(back)))
    assert (done.complete, done.problems) == ([FIRST, SECOND], [])
    assert files_below(back) == files_below(recordings)
    assert copy_recordings(stored_recordings(str(there)), open_store(str(back))).copied == []


def test_one_recording_or_one_file_is_copied_as_such(recordings: Path, tmp_path: Path) -> None:
    whole = {key: data for key, data in files_below(recordings).items() if key.startswith(FIRST)}
    for name, wanted in ((FIRST, whole), (DATA, {f"{FIRST}_0.mcap": whole[DATA]})):
        source, back = recordings / name, tmp_path / "back"
        for offered in (local_recordings(source, time.time_ns()), stored_recordings(str(source))):
            copy_recordings(offered, open_store(str(back)))
            assert files_below(back) == wanted
            shutil.rmtree(back)


def test_what_does_not_have_the_hash_it_was_stored_with_is_named_and_not_copied(
    recordings: Path, store: MemoryStore, tmp_path: Path
) -> None:
    in_earlier_layout(recordings, store)
    for key, content in store.objects.items():
        changed = content[:-1] + b"?" if key.endswith("_0.mcap") and FIRST in key else content
        open_store(str(tmp_path / "there")).put_if_absent(key, [changed])
    done = copy_recordings(
        stored_recordings(str(tmp_path / "there")), open_store(str(tmp_path / "back"))
    )
    assert done.complete == [SECOND]
    assert "does not hold what was stored" in done.wrong[0]
    assert not (tmp_path / "back" / DATA).exists()


def test_a_run_that_is_killed_at_any_request_goes_on_with_what_is_missing(run: Run) -> None:
    run()
    whole = dict(run.store.objects)
    for number in range(1, len(whole) + 1):
        run.store.objects.clear()
        run.store.requests.clear()

        def killed(request: str, key: str, at: int = number) -> None:
            if len(run.store.puts()) == at:
                raise Killed

        run.store.before = killed
        with pytest.raises(Killed):
            run()
        run.store.before = works
        for name in (FIRST, SECOND):
            if f"{name}/metadata.yaml" in run.store.objects:
                assert f"{name}/{name}_0.mcap" in run.store.objects, (
                    "the list is there before a file"
                )
        there = len(run.store.objects)
        run.store.requests.clear()
        run()
        assert run.store.objects == whole
        assert len(run.store.puts()) == len(whole) - there, "a file was sent twice"


def test_a_store_that_fails_often_gets_everything_in_the_end(run: Run) -> None:
    for day in range(10, 28):
        run.add(f"robot_202601{day}_120000")
    chance = random.Random(17)

    def fails(request: str, key: str) -> None:
        if request != "list" and chance.random() < 0.05:
            raise StoreFailed("memory: the store answers with HTTP status 503")

    run.store.before = fails
    first = run()
    assert 0 < len(first.problems) == 20 - len(first.complete)
    assert all("HTTP status 503" in said for said in first.problems)
    for _ in range(5):
        last = run()
    assert (len(last.complete), last.problems) == (20, [])
    assert run.store.objects == files_below(run.recordings)


def test_a_store_that_is_away_is_not_asked_for_every_recording(run: Run) -> None:
    for day in range(10, 28):
        run.add(f"robot_202601{day}_120000")
    run.store.before = away
    done = run()
    assert len(run.store.puts()) == GIVE_UP_AFTER
    assert "the rest is left for later" in done.problems[-1]


def test_only_failures_in_a_row_end_a_run(run: Run) -> None:
    days = [FIRST, SECOND, *(f"robot_2026020{day}_120000" for day in (1, 2, 3))]
    for name in days[2:]:
        run.add(name)
    wrong = days[GIVE_UP_AFTER - 1]
    run.store.objects = {f"{wrong}/{wrong}_0.mcap": b"short"}
    run.store.before = away
    done = run()
    assert len(done.wrong) == 1
    assert [said.partition(":")[0] for said in done.problems] == [x for x in days if x != wrong]


def test_of_a_recording_that_is_being_made_the_finished_files_are_there(run: Run) -> None:
    folder = run.recordings / SECOND
    shutil.copy(folder / f"{SECOND}_0.mcap", folder / f"{SECOND}_1.mcap")
    with writing(folder / f"{SECOND}_1.mcap"):
        done = run()
    assert (done.complete, done.live, done.problems) == ([FIRST], [SECOND], [])
    assert [key for key in run.store.objects if SECOND in key] == [f"{SECOND}/{SECOND}_0.mcap"]
    assert run().complete == [FIRST, SECOND]
    assert run.store.objects == files_below(run.recordings)


def test_a_newer_index_or_list_replaces_the_older_one_and_data_never_does(run: Run) -> None:
    run()
    before = dict(run.store.objects)
    index = run.recordings / FIRST / "index.parquet"
    for content in (b"an index", b"a newer."):
        index.write_bytes(content)
        assert names(run()) == ["index.parquet"]
        assert run.store.objects[f"{FIRST}/index.parquet"] == content
    assert run().copied == []
    (run.recordings / DATA).write_bytes(before[DATA] + b"more")
    done = run()
    assert (done.complete, done.copied) == ([SECOND], [])
    assert f"memory/{DATA} has other content than the file here" in done.wrong[0]
    assert run.store.objects[DATA] == before[DATA]


def test_a_list_that_tells_less_than_the_one_there_does_not_replace_it(run: Run) -> None:
    shutil.copy(run.recordings / DATA, run.recordings / FIRST / f"{FIRST}_1.mcap")
    run()
    before = dict(run.store.objects)
    (run.recordings / DATA).unlink()  # as retention does
    (run.recordings / FIRST / "metadata.yaml").write_text("rewritten for the files that are left")
    assert run().problems == []
    assert run.store.objects == before
    shutil.rmtree(run.recordings / SECOND)
    assert run().complete == [FIRST]
    assert run.store.objects == before


def test_a_file_that_has_vanished_there_is_copied_again(run: Run) -> None:
    run()
    del run.store.objects[DATA]
    assert names(run()) == [f"{FIRST}_0.mcap"]
    assert run.store.objects == files_below(run.recordings)


def test_a_file_that_is_written_while_it_is_copied_is_named_and_not_stored(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashed = sources.LocalFile.sha256

    def write_after(file: sources.LocalFile, pace: sources.Pace) -> str:
        found = hashed(file, pace)
        if file.key == DATA:
            file.path.write_bytes(file.path.read_bytes()[:-1] + b"X")
        return found

    with monkeypatch.context() as patched:
        patched.setattr(sources.LocalFile, "sha256", write_after)
        first = run()
    assert first.complete == [SECOND]
    assert named(first, "was written while it was copied")
    assert not [key for key in run.store.objects if FIRST in key]
    assert run().complete == [FIRST, SECOND]
    assert run.store.objects == files_below(run.recordings)


def test_no_link_leads_a_copy_elsewhere(run: Run) -> None:
    secret = run.recordings.parent / "secret"
    secret.write_text("a private key")
    for name in ("metadata.yaml", "index.parquet", f"{FIRST}_1.mcap"):
        (run.recordings / FIRST / name).unlink(missing_ok=True)
        (run.recordings / FIRST / name).symlink_to(secret)
    (run.recordings / "linked_20260101_120000").symlink_to(run.recordings / SECOND)
    run()
    assert b"a private key" not in run.store.objects.values()
    assert {key.partition("/")[0] for key in run.store.objects} == {FIRST, SECOND}


def test_a_link_to_recordings_elsewhere_is_named_and_one_to_its_neighbour_needs_nothing(
    run: Run, one_recording: Path
) -> None:
    (run.recordings / "old").symlink_to(one_recording)
    (run.recordings / "latest").symlink_to(SECOND)
    (run.recordings / "tools").symlink_to("/usr")
    done = run()
    assert done.complete == [FIRST, SECOND]
    assert done.problems == ["old: it is left out: it is a link"]


def test_a_name_that_not_every_store_can_hold_is_named(run: Run) -> None:
    run.add("a\x1b[31m b")
    done = run()
    assert done.complete == [FIRST, SECOND]
    assert "is left out" in done.problems[0]
    assert "\x1b" not in done.problems[0]


def test_a_renamed_a_damaged_and_a_foreign_recording_are_copied(run: Run) -> None:
    (run.recordings / FIRST).rename(run.recordings / "crash_at_dock")
    torn(run.recordings / SECOND)
    (run.recordings / "bag").mkdir()
    for path in (run.recordings / "bag" / "run.mcap", run.recordings / "dock.mcap"):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(library="another recorder")
            writer.finish()
    done = run()
    assert (done.complete, done.problems) == (["bag", "crash_at_dock", "dock", SECOND], [])
    assert run.store.objects == files_below(run.recordings)


@pytest.mark.parametrize("kind", ["FIFO", "link", "odd name"])
def test_a_file_that_cannot_be_copied_is_named_and_the_data_of_its_recording_copied(
    run: Run, kind: str
) -> None:
    folder = run.recordings / FIRST
    odd = folder / ("a copy.mcap" if kind == "odd name" else f"{FIRST}_1.mcap")
    if kind == "FIFO":
        os.mkfifo(odd)
    elif kind == "link":
        odd.symlink_to(run.recordings / SECOND / f"{SECOND}_0.mcap")
    else:
        shutil.copy(folder / f"{FIRST}_0.mcap", odd)
    done = run()
    assert done.complete == [SECOND]
    assert named(done, f"{FIRST}: {odd.name}")
    assert DATA in run.store.objects


def test_a_file_that_the_disk_cannot_read_keeps_no_other_back(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = torn(run.recordings / FIRST)

    def opened(path: Path) -> AbstractContextManager[FileIO]:
        if path.name == f"{FIRST}_0.mcap" and run.store.requests:
            raise UnreadableFile(f"{path.name} cannot be read: {os.strerror(errno.EIO)}")
        return open_regular_file(path)

    with monkeypatch.context() as patched:
        patched.setattr(sources, "open_regular_file", opened)
        done = run()
    assert done.complete == [SECOND]
    assert named(done, FIRST, f"{FIRST}_0.mcap", "Input/output error")
    assert [key for key in run.store.objects if FIRST in key] == [f"{FIRST}/{late.name}"]
    assert run().complete == [FIRST, SECOND]
    assert run.store.objects == files_below(run.recordings)


def test_a_folder_that_cannot_be_listed_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (OF_THE_SYSTEM, ".Trash"):
        (run.recordings / name).mkdir()
    listed = os.scandir

    def scandir(path: object = ".") -> object:
        if Path(str(path)).name in (FIRST, OF_THE_SYSTEM, ".Trash"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return listed(path)  # type: ignore[call-overload]

    monkeypatch.setattr(os, "scandir", scandir)
    done = run()
    assert done.complete == [SECOND]
    assert done.problems == [f"{FIRST}: it cannot be listed: Permission denied"]


def test_a_file_of_another_recorder_is_copied_when_it_has_an_end_or_rests(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "bag_0.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="another recorder")
        stream.flush()
        (growing,) = local_recordings(tmp_path, time.time_ns())
        assert (growing.live, growing.files) == (True, [])
        (resting,) = local_recordings(tmp_path, time.time_ns() + YOUNG_NS)
        assert (resting.live, len(resting.files)) == (False, 1)
        writer.finish()
    (finished,) = local_recordings(tmp_path, time.time_ns())
    assert (finished.live, len(finished.files)) == (False, 1)


def test_an_object_that_was_changed_keeps_no_other_file_from_the_store(run: Run) -> None:
    run()
    run.store.objects[DATA] = b"short"
    late = torn(run.recordings / FIRST)
    done = run()
    assert DATA in done.wrong[0]
    assert names(done) == [late.name]


def test_each_piece_that_is_read_waits_for_its_turn(store: MemoryStore, recordings: Path) -> None:
    asked: list[int] = []
    copy_recordings(local_recordings(recordings, time.time_ns()), store, pace=asked.append)
    total = sum(map(len, files_below(recordings).values()))
    assert sum(asked) == total
    assert asked.count(0) > total / PIECE_BYTES
