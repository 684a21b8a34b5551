"""Every recording is copied, also a damaged or a foreign one; what cannot be copied is named."""

from __future__ import annotations

import errno
import os
import shutil
import time
from contextlib import AbstractContextManager
from io import FileIO
from pathlib import Path

import pytest
from mcap.writer import Writer

from robotctl.collect import recording_copy
from robotctl.collect.collecting import GIVE_UP_AFTER, Collected
from robotctl.collect.local_files import open_collected
from robotctl.collect.local_recordings import OF_THE_SYSTEM, YOUNG_NS, local_recordings
from robotctl.errors import UnreadableFile
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
from tests.support.memory_store import MemoryStore


def torn(recording: Path) -> Path:
    """Add a file to a recording whose header a crash has left empty."""
    data = (recording / f"{recording.name}_0.mcap").read_bytes()
    file = recording / f"{recording.name}_1.mcap"
    file.write_bytes(bytes(4) + data[4:])
    an_hour_ago(file)
    return file


def an_hour_ago(file: Path) -> None:
    os.utime(file, (time.time() - 3600,) * 2)


def named(done: Collected, *words: str) -> bool:
    """Return whether one of the sentences holds all of these words."""
    return any(all(word in said for word in words) for said in done.problems)


def test_a_renamed_a_damaged_and_a_foreign_recording_are_copied(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    (recordings / FIRST).rename(recordings / "crash_at_dock")
    torn(recordings / SECOND)
    (recordings / "bag").mkdir()
    with (recordings / "bag" / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(library="another recorder")
        writer.finish()
    done = run()
    assert (done.complete, done.problems) == (["bag", "crash_at_dock", SECOND], [])
    for name in done.complete:
        assert stored_files(store, name) == files_here(recordings / name)


def test_a_single_file_becomes_a_recording_of_its_name(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    file = recordings / "dock.mcap"
    (recordings / FIRST / f"{FIRST}_0.mcap").rename(file)
    assert "dock" in run().complete
    assert stored_files(store, "dock") == {"dock.mcap": file.read_bytes()}


def test_a_single_file_with_the_name_of_a_folder_is_named(run: Collect, recordings: Path) -> None:
    shutil.copy(recordings / FIRST / f"{FIRST}_0.mcap", recordings / f"{FIRST}.mcap")
    done = run()
    assert done.complete == [FIRST, SECOND]
    assert done.problems == [
        f"{FIRST}: {FIRST}.mcap is left out: a folder has its name: rename one of them"
    ]


@pytest.mark.parametrize("kind", ["FIFO", "link", "odd name"])
def test_a_file_that_cannot_be_copied_is_named_and_the_rest_of_its_recording_copied(
    run: Collect, store: MemoryStore, recordings: Path, kind: str
) -> None:
    folder = recordings / FIRST
    whole = files_here(folder)
    odd = folder / ("a copy.mcap" if kind == "odd name" else f"{FIRST}_1.mcap")
    if kind == "FIFO":
        os.mkfifo(odd)
    elif kind == "link":
        odd.symlink_to(recordings / SECOND / f"{SECOND}_0.mcap")
    else:
        shutil.copy(folder / f"{FIRST}_0.mcap", odd)
    done = run()
    assert done.complete == [SECOND]
    assert named(done, f"{FIRST}: {odd.name}")
    assert stored_files(store, FIRST) == whole


def test_a_file_that_the_disk_cannot_read_keeps_no_other_back(
    run: Collect, store: MemoryStore, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torn(recordings / FIRST)
    whole = files_here(recordings / FIRST)
    wanted = f"{FIRST}_0.mcap"
    readable = open_collected

    def opened(path: Path) -> AbstractContextManager[FileIO]:
        if path.name == wanted:
            raise UnreadableFile(f"{path.name} cannot be read: {os.strerror(errno.EIO)}")
        return readable(path)

    with monkeypatch.context() as patched:
        patched.setattr(recording_copy, "open_collected", opened)
        done = run()
    assert done.complete == [SECOND]
    assert named(done, FIRST, wanted, "Input/output error")
    assert contents(store)[FIRST].manifest is None
    there = {key.rpartition("/")[2] for key in store.objects if key.startswith(FIRST)}
    assert there == whole.keys() - {wanted}
    assert run().complete == [FIRST, SECOND]
    assert stored_files(store, FIRST) == whole


def test_a_folder_that_cannot_be_listed_is_named(
    run: Collect, recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (OF_THE_SYSTEM, ".Trash"):
        (recordings / name).mkdir()
    listed = os.scandir

    def scandir(path: object = ".") -> object:
        if Path(str(path)).name in (FIRST, OF_THE_SYSTEM, ".Trash"):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return listed(path)  # type: ignore[call-overload]

    monkeypatch.setattr(os, "scandir", scandir)
    done = run()
    assert done.complete == [SECOND]
    assert done.problems == [f"{FIRST}: it cannot be listed: Permission denied"]


def test_a_link_to_recordings_elsewhere_is_named_and_one_to_its_neighbour_needs_nothing(
    run: Collect, recordings: Path, one_recording: Path
) -> None:
    (recordings / "old").symlink_to(one_recording)
    (recordings / "latest").symlink_to(SECOND)
    (recordings / "tools").symlink_to("/usr")
    done = run()
    assert done.complete == [FIRST, SECOND]
    assert done.problems == ["old: it is left out: it is a link"]


def test_a_recording_whose_first_file_is_being_written_is_named(
    run: Collect, recordings: Path
) -> None:
    with writing(recordings / SECOND / f"{SECOND}_0.mcap"):
        done = run()
    assert (done.complete, done.live, done.problems) == ([FIRST], [SECOND], [])


def test_a_file_of_another_recorder_is_copied_when_it_has_an_end_or_rests(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    file = tmp_path / "bag" / "bag_0.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="another recorder")
        stream.flush()
        (growing,) = local_recordings(tmp_path, time.time_ns())
        assert (growing.live, growing.files) == (True, {})
        (resting,) = local_recordings(tmp_path, time.time_ns() + YOUNG_NS)
        assert (resting.live, list(resting.files)) == (False, [file.name])
        writer.finish()
    (finished,) = local_recordings(tmp_path, time.time_ns())
    assert (finished.live, list(finished.files)) == (False, [file.name])


def test_an_object_that_was_changed_keeps_no_other_file_from_the_store(
    run: Collect, store: MemoryStore, recordings: Path
) -> None:
    run()
    (changed,) = (key for key in store.objects if key.endswith(f"{FIRST}_0.mcap"))
    store.objects[changed] = b"short"
    late = torn(recordings / FIRST)
    done = run()
    assert changed in done.wrong[0]
    assert [file.name for file in done.copied[FIRST]] == [late.name]


def test_only_failures_in_a_row_end_a_run(
    run: Collect, store: MemoryStore, recordings: Path, one_recording: Path
) -> None:
    names = [FIRST, SECOND, *(f"robot_2026020{day}_120000" for day in (1, 2, 3))]
    for name in names[2:]:
        copy_as(one_recording, recordings / name)
    run()
    wrong = names[GIVE_UP_AFTER - 1]
    for key in [key for key in store.objects if not key.startswith(wrong)]:
        del store.objects[key]
    (changed,) = (key for key in store.objects if key.endswith(".mcap"))
    store.objects[changed] = b"short"

    def away(request: str, key: str) -> None:
        if request == "put":
            raise StoreFailed("memory: it refuses the connection")

    store.before = away
    done = run()
    assert len(done.wrong) == 1
    assert [said.partition(":")[0] for said in done.problems] == [x for x in names if x != wrong]
