"""Retention removes the oldest recordings of robotctl, and no protected ones.

The list of recordings shows all of them, of any writer, damaged ones as well.
"""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader as RosbagsReader

from robotctl.kernel.constants import DAY_S
from robotctl.recording import Recorder, read_info
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import ClipJob, Moment, make_clip
from robotctl.recording.keep.listing import ListedRecording, list_recordings, set_kept
from robotctl.recording.keep.repair import TidyJob, tidy
from robotctl.recording.keep.retention import (
    NOTES_FILE,
    RetentionPolicy,
    enforce_retention,
    note_removal,
)
from robotctl.testing.drives import START_NS
from tests.support.bags import TWIST as TWIST_TYPE
from tests.support.bags import Line, twist, write_bag
from tests.support.recordings import Tape, by_mcap, read_strictly
from tests.support.waiting import until, until_longer

NOW_S = 2_000_000_000.0


def recorded(folder: Path, age_s: float, splits: int = 0) -> int:
    """Record some messages `age_s` ago; return the bytes of the recording's files."""
    recorder = Tape(folder)
    recorder.commands(range(1, 11))
    for split in range(splits):
        recorder.split()
        until_longer(recorder.begun, split)
        recorder.commands(range(11, 21))
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


def test_part_of_a_recording_may_go_and_the_rest_is_a_bag(tmp_path: Path) -> None:
    recorded(tmp_path / "run", age_s=100.0, splits=3)
    last = (tmp_path / "run" / "run_3.mcap").stat().st_size
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=last), NOW_S)
    assert names(tmp_path / "run") == ["metadata.yaml", "run_3.mcap"]
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 10
    assert read_info(tmp_path / "run").missing == ()


def clipped(folder: Path, age_s: float) -> int:
    """Cut a clip from a recording `age_s` ago; return its bytes."""
    moment = Moment(read_info(folder).start_ns)
    clip = make_clip(ClipJob(folder, moment, 1.0, 1.0)).target
    os.utime(clip, (NOW_S - age_s, NOW_S - age_s))
    return clip.stat().st_size


def test_what_is_too_old_goes_with_its_clips_unless_it_is_marked_keep(tmp_path: Path) -> None:
    for name in ("old", "kept"):
        recorded(tmp_path / name, age_s=31 * DAY_S)
        clipped(tmp_path / name, age_s=31 * DAY_S)
    recorded(tmp_path / "new", age_s=29 * DAY_S)
    (tmp_path / "kept" / "keep").touch()
    enforce_retention(tmp_path, RetentionPolicy(), NOW_S)
    assert names(tmp_path) == ["kept", "new"]
    enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
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
    recorder = Tape(tmp_path / "run")
    recorder.commands(range(1, 11))
    recorder.split()
    until(lambda: bool(recorder.begun))
    recorder.commands(range(11, 21))
    removed = enforce_retention(tmp_path, RetentionPolicy(max_bytes=0), NOW_S)
    assert [each.path.name for each in removed] == ["run_0.mcap"]
    until(lambda: read_info(tmp_path / "run").missing == ())  # also while it goes on
    stats = recorder.close()
    assert [m.sequence for m in read_strictly(stats.file)] == list(range(11, 21))
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 10


def test_what_robotctl_has_not_recorded_stays(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    by_mcap(tmp_path / "theirs" / "theirs_0.mcap")
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


def record(folder: Path, *events: RecordedEvent) -> Recorder:
    recorder = Tape(folder, metadata=lambda: {"robot": "r2"})
    recorder.commands(range(1, 101))
    for event in events:
        recorder.add_event(event)
    return recorder


def event(kind: EventKind, laps: int = 0) -> RecordedEvent:
    return RecordedEvent(kind, START_NS, "because", laps)


def listed(folder: Path) -> dict[str, ListedRecording]:
    return {each.path.name: each for each in list_recordings(folder)}


def test_a_recording_is_told_with_its_laps_and_the_worst_that_happened(tmp_path: Path) -> None:
    mark, ended = event(EventKind.MARK), event(EventKind.DRIVE_ENDED, 2)
    error, stop = event(EventKind.ERROR), event(EventKind.EMERGENCY_STOP)
    record(tmp_path / "calm", mark, ended, ended).close()
    record(tmp_path / "bad", error, mark).close()
    record(tmp_path / "worse", error, stop, error).close()
    found = listed(tmp_path)
    assert {name: (each.worst, each.laps) for name, each in found.items()} == {
        "bad": (EventKind.ERROR, 0),
        "calm": (None, 4),
        "worse": (EventKind.EMERGENCY_STOP, 0),
    }
    calm = found["calm"]
    assert (calm.robot, calm.files, calm.readable, calm.damage) == ("r2", 1, True, ())
    assert (calm.start_ns, calm.duration_s) == (START_NS + 1_000_000, 0.099)
    assert calm.size_bytes == (tmp_path / "calm" / "calm_0.mcap").stat().st_size
    assert (calm.live, calm.kept, calm.clips) == (False, False, ())


def test_of_drives_their_largest_errors_and_their_time_together_are_told(tmp_path: Path) -> None:
    ended = event(EventKind.DRIVE_ENDED, 1)
    drives = (
        replace(ended, heading_max_rad=0.02, closure_m=0.01, drive_s=4.0),
        replace(ended, heading_max_rad=0.03, true_heading_max_rad=0.05, drive_s=5.5),
    )
    record(tmp_path / "driven", *drives).close()
    record(tmp_path / "before", ended).close()  # by a version that told no duration
    driven, before = listed(tmp_path)["driven"], listed(tmp_path)["before"]
    assert (driven.driven_s, before.driven_s) == (9.5, None)
    assert (driven.largest("heading_max_rad"), driven.largest("closure_m")) == (0.03, 0.01)
    assert driven.largest("true_heading_max_rad") == 0.05
    assert before.largest("heading_max_rad") is None


def test_what_is_being_recorded_is_live_and_what_is_marked_is_kept(tmp_path: Path) -> None:
    recorder = record(tmp_path / "run")
    try:
        set_kept(tmp_path / "run", True)
        assert (listed(tmp_path)["run"].live, listed(tmp_path)["run"].kept) == (True, True)
    finally:
        recorder.close()
    set_kept(tmp_path / "run", False)
    set_kept(tmp_path / "run", False)
    assert (listed(tmp_path)["run"].live, listed(tmp_path)["run"].kept) == (False, False)


def test_a_torn_recording_is_listed_with_what_can_be_read(tmp_path: Path) -> None:
    path = record(tmp_path / "run", event(EventKind.ERROR)).close().file
    path.write_bytes(path.read_bytes()[:-30])
    torn = listed(tmp_path)["run"]
    assert (torn.readable, torn.worst, torn.duration_s) == (True, EventKind.ERROR, 0.099)
    assert torn.damage
    path.write_bytes(b"")
    assert (listed(tmp_path)["run"].readable, listed(tmp_path)["run"].damage) == (
        False,
        ("run_0.mcap: it is empty",),
    )


def test_recordings_of_others_are_listed_and_what_is_none_is_not(tmp_path: Path) -> None:
    write_bag(tmp_path / "theirs.mcap", [Line("/a", TWIST_TYPE, 0, twist(1.0))])
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "theirs.mcap")
    found = listed(tmp_path)
    assert list(found) == ["theirs.mcap"]
    assert (found["theirs.mcap"].robot, found["theirs.mcap"].readable) == ("", True)


def test_progress_is_told_up_to_all(tmp_path: Path) -> None:
    for number in range(3):
        record(tmp_path / f"run{number}").close()
    steps: list[tuple[int, int]] = []
    assert len(list(list_recordings(tmp_path, lambda *step: steps.append(step)))) == 3
    assert steps == [(0, 3), (1, 3), (2, 3), (3, 3)]
