"""Retention removes the oldest recordings of robotctl, and no protected ones."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from mcap.writer import Writer
from rosbags.rosbag2 import Reader as RosbagsReader

from robotctl.kernel.units import DAY_S
from robotctl.recording import Recorder, RecorderOptions, read_info
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import ClipJob, make_clip
from robotctl.recording.keep.retention import (
    NOTES_FILE,
    RetentionPolicy,
    enforce_retention,
    note_removal,
)
from robotctl.recording.keep.tidy_job import TidyJob, tidy
from robotctl.testing.drives import TWIST
from tests.support.recordings import read_strictly, write_numbered
from tests.support.waiting import until, until_longer

NOW_S = 2_000_000_000.0


def recorded(folder: Path, age_s: float, splits: int = 0) -> int:
    """Record some messages `age_s` ago; return the bytes of the recording's files."""
    begun: list[Path] = []
    recorder = Recorder(folder, on_failure=pytest.fail, on_split=begun.append)
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 11))
    for split in range(splits):
        recorder.split()
        until_longer(begun, split)
        write_numbered(recorder, channel, range(11, 21))
    recorder.close()
    files = sorted(folder.glob("*.mcap"))
    for number, path in enumerate(files):
        os.utime(path, (NOW_S - age_s + number, NOW_S - age_s + number))
    return sum(path.stat().st_size for path in files)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_oldest_go_until_the_rest_fits(tmp_path: Path) -> None:
    sizes = [recorded(tmp_path / f"run{n}", age_s=100.0 - n) for n in range(5)]
    removed = enforce_retention(tmp_path, RetentionPolicy(max_bytes=sum(sizes[2:])), NOW_S)
    assert [each.path.name for each in removed] == ["run0_0.mcap", "run1_0.mcap"]
    assert [each.size for each in removed] == sizes[:2]
    assert names(tmp_path) == ["run2", "run3", "run4"]
    assert enforce_retention(tmp_path, RetentionPolicy(max_bytes=sum(sizes[2:])), NOW_S) == []


def test_what_robotctl_made_of_a_recording_goes_with_it_and_nothing_else(tmp_path: Path) -> None:
    for name in ("run", "mine"):
        recorded(tmp_path / name, age_s=100.0)
        for made in ("path.png", "report.html", "index.parquet", "compared_with_other.html"):
            (tmp_path / name / made).touch()
    (tmp_path / "mine" / "notes.txt").touch()
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
    assert names(tmp_path) == ["mine"]
    assert names(tmp_path / "mine") == ["notes.txt"]


def test_what_is_too_old_goes(tmp_path: Path) -> None:
    recorded(tmp_path / "old", age_s=31 * DAY_S)
    recorded(tmp_path / "new", age_s=29 * DAY_S)
    enforce_retention(tmp_path, RetentionPolicy(), NOW_S)
    assert names(tmp_path) == ["new"]


def test_without_limits_everything_stays(tmp_path: Path) -> None:
    recorded(tmp_path / "old", age_s=1000 * DAY_S)
    assert enforce_retention(tmp_path, RetentionPolicy(max_bytes=None, max_age_s=None), NOW_S) == []


def test_part_of_a_recording_may_go_and_the_rest_is_a_bag(tmp_path: Path) -> None:
    recorded(tmp_path / "run", age_s=100.0, splits=3)
    last = (tmp_path / "run" / "run_3.mcap").stat().st_size
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=last), NOW_S)
    assert names(tmp_path / "run") == ["metadata.yaml", "run_3.mcap"]
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 10
    assert read_info(tmp_path / "run").missing == ()


def test_a_recording_marked_keep_stays(tmp_path: Path) -> None:
    recorded(tmp_path / "run", age_s=1000 * DAY_S)
    (tmp_path / "run" / "keep").touch()
    assert enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S) == []


def clipped(folder: Path, age_s: float) -> int:
    """Cut a clip from a recording `age_s` ago; return its bytes."""
    moment = Moment(read_info(folder).start_ns)
    clip = make_clip(ClipJob(folder, moment, 1.0, 1.0)).target
    os.utime(clip, (NOW_S - age_s, NOW_S - age_s))
    return clip.stat().st_size


def test_clips_go_with_their_recordings(tmp_path: Path) -> None:
    for name in ("old", "kept"):
        recorded(tmp_path / name, age_s=1000 * DAY_S)
        clipped(tmp_path / name, age_s=1000 * DAY_S)
    (tmp_path / "kept" / "keep").touch()
    enforce_retention(tmp_path, RetentionPolicy(), NOW_S)
    assert names(tmp_path) == ["kept"]
    assert len(names(tmp_path / "kept" / "clips")) == 1


def test_clips_count_and_a_younger_one_outlives_its_recording(tmp_path: Path) -> None:
    size = recorded(tmp_path / "run", age_s=100.0)
    older, younger = clipped(tmp_path / "run", age_s=200.0), clipped(tmp_path / "run", age_s=50.0)
    metadata = (tmp_path / "run" / "metadata.yaml").stat()
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=size + younger + older - 1), NOW_S)
    assert len(names(tmp_path / "run" / "clips")) == 1
    assert (tmp_path / "run" / "metadata.yaml").stat() == metadata
    assert read_info(tmp_path / "run").message_count == 10
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=younger), NOW_S)
    assert names(tmp_path / "run") == ["clips"]
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
    assert names(tmp_path) == []


def test_the_file_being_written_stays_and_its_bag_forgets_the_removed(tmp_path: Path) -> None:
    begun: list[Path] = []
    recorder = Recorder(
        tmp_path / "run", RecorderOptions(), on_failure=pytest.fail, on_split=begun.append
    )
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 11))
    recorder.split()
    until(lambda: bool(begun))
    write_numbered(recorder, channel, range(11, 21))
    removed = enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
    assert [each.path.name for each in removed] == ["run_0.mcap"]
    until(lambda: read_info(tmp_path / "run").missing == ())  # also while it goes on
    stats = recorder.close()
    assert [m.sequence for m in read_strictly(stats.file)] == list(range(11, 21))
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 10


def test_what_robotctl_has_not_recorded_stays(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    with (tmp_path / "theirs" / "theirs_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="somebody")
        writer.finish()
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "notes_0.mcap").write_text("not even MCAP")
    (tmp_path / "file.mcap").write_bytes(b"")
    recorded(tmp_path / "away" / "linked", age_s=1000 * DAY_S)
    (tmp_path / "linked").symlink_to(tmp_path / "away" / "linked")
    recorded(tmp_path / "run", age_s=1000 * DAY_S)
    (tmp_path / "run" / "photo.png").write_text("a picture")
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
    assert names(tmp_path) == ["away", "file.mcap", "linked", "notes", "run", "theirs"]
    assert names(tmp_path / "away" / "linked") == ["linked_0.mcap", "metadata.yaml"]
    assert names(tmp_path / "run") == ["photo.png"]
    assert names(tmp_path / "theirs") == ["theirs_0.mcap"]


def test_what_another_daemon_has_removed_first_counts_as_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = [recorded(tmp_path / f"run{n}", age_s=100.0 - n) for n in range(3)]
    unlink = Path.unlink

    def beaten(self: Path, missing_ok: bool = False) -> None:
        unlink(self, missing_ok)
        if self.name == "run0_0.mcap":
            raise FileNotFoundError

    monkeypatch.setattr(Path, "unlink", beaten)
    assert enforce_retention(tmp_path, RetentionPolicy(max_bytes=sum(sizes[1:])), NOW_S) == []
    assert names(tmp_path) == ["run1", "run2"]


def test_a_file_system_without_such_locks_is_tidied_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(tmp_path / "run", age_s=0.0)

    def no_lock(fd: int, operation: int) -> None:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setattr("robotctl.recording.keep.retention.flock", no_lock)
    (done,) = tidy(TidyJob(tmp_path, RetentionPolicy(max_bytes=0), repairs=False))
    assert done.text.startswith("removed for its age or to free space: ")
    assert names(tmp_path) == []


def test_a_removal_that_another_program_noted_is_told_once_when_it_is_done(tmp_path: Path) -> None:
    recorded(tmp_path / "run", age_s=0.0)
    file = tmp_path / "run" / "run_0.mcap"
    job = TidyJob(tmp_path, RetentionPolicy(), repairs=False)
    note_removal(tmp_path, file, "removed after its copy was read")
    with (tmp_path / NOTES_FILE).open("ab") as notes:
        notes.write(b"[1]\n\xff\n[[[")
    assert list(tidy(job)) == []
    file.unlink()
    (done,) = tidy(job)
    assert (done.removed, done.problem) == (str(file), False)
    assert list(tidy(job)) == []
    assert names(tmp_path) == ["run"]
