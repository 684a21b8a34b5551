"""The list of recordings shows all of them, of any writer, damaged ones as well."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.recording import Recorder
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.listing import ListedRecording, list_recordings, set_kept
from robotctl.testing.drives import START_NS, TWIST
from tests.support.bags import TWIST as TWIST_TYPE
from tests.support.bags import Line, twist, write_bag
from tests.support.recordings import write_numbered


def record(folder: Path, *events: RecordedEvent) -> Recorder:
    recorder = Recorder(folder, metadata=lambda: {"robot": "r2"}, on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 101))
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
