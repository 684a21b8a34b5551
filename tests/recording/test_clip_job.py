"""A clip of a live recording waits for the end of its window, and no longer."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from robotctl.errors import Refused
from robotctl.recording import Recorder, read_info
from robotctl.recording.format.names import EventKind
from robotctl.recording.keep import clip_job
from robotctl.recording.keep.clip import Moment
from robotctl.recording.keep.clip_job import ClipJob, make_clip, remaining_s
from robotctl.recording.keep.listing import list_recording
from robotctl.testing.drives import GID, TWIST
from tests.support.recordings import numbered, read_strictly


def test_what_comes_after_the_event_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_job, "PATIENCE_S", 30.0)
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    channel, moment = recorder.add_topic(TWIST), Moment(time.time_ns(), EventKind.ERROR, "now")
    job = ClipJob(tmp_path / "run", moment, before_s=5.0, after_s=1.0)
    written: list[int] = []
    with ThreadPoolExecutor(1) as thread:
        try:
            recorder.write(channel, numbered(0), moment.log_ns, 0, 0, GID)
            assert remaining_s(job, list_recording(job.source)) > 0
            making = thread.submit(make_clip, job)
            while not making.done():
                now_ns = time.time_ns()
                recorder.write(channel, numbered(0), now_ns, 0, 0, GID)
                written.append(now_ns)
                time.sleep(0.01)
            made = making.result()
        finally:
            recorder.close()
    due = [at_ns for at_ns in (moment.log_ns, *written) if at_ns <= job.end_ns]
    assert [m.log_ns for m in read_strictly(made.target)] == due
    assert remaining_s(job, list_recording(job.source)) == 0


def test_a_recording_that_has_ended_is_not_waited_for(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    now_ns = time.time_ns()
    recorder.write(recorder.add_topic(TWIST), numbered(0), now_ns, 0, 0, GID)
    recorder.close()
    job = ClipJob(tmp_path / "run", Moment(now_ns), before_s=5.0, after_s=3600.0)
    assert remaining_s(job, list_recording(job.source)) == 0
    assert make_clip(job).message_count == 1


def test_a_recording_that_has_fallen_silent_is_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_job, "PATIENCE_S", 0.2)
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    try:
        now_ns = time.time_ns()
        recorder.write(recorder.add_topic(TWIST), numbered(0), now_ns, 0, 0, GID)
        job = ClipJob(tmp_path / "run", Moment(now_ns), before_s=5.0, after_s=0.3)
        assert make_clip(job).message_count == 1
    finally:
        recorder.close()


def test_a_clock_that_was_set_back_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_job, "PATIENCE_S", 0.2)
    in_an_hour_ns = time.time_ns() + 3600 * 10**9
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    try:
        recorder.write(recorder.add_topic(TWIST), numbered(0), in_an_hour_ns, 0, 0, GID)
        job = ClipJob(tmp_path / "run", Moment(in_an_hour_ns), before_s=5.0, after_s=0.3)
        assert make_clip(job).message_count == 1
    finally:
        recorder.close()


def test_a_clip_without_a_name_finds_a_free_one(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    recorder.write(recorder.add_topic(TWIST), numbered(0), 10**18, 0, 0, GID)
    file = recorder.close().file
    moment = Moment(10**18, EventKind.EMERGENCY_STOP)
    at = time.strftime("%H%M%S", time.localtime(10**9))
    targets = [make_clip(ClipJob(tmp_path / "run", moment, 1, 1)).target for _ in range(3)]
    clips = tmp_path / "run" / "clips"
    assert targets == [
        clips / f"run_estop_{at}.mcap",
        clips / f"run_estop_{at}-2.mcap",
        clips / f"run_estop_{at}-3.mcap",
    ]
    assert make_clip(ClipJob(file, moment, 1, 1)).target == clips / f"run_0_estop_{at}.mcap"
    assert read_info(tmp_path / "run").message_count == 1


def test_a_file_in_the_place_of_the_folder_of_clips_is_named(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    recorder.write(recorder.add_topic(TWIST), numbered(0), 10**18, 0, 0, GID)
    recorder.close()
    (tmp_path / "run" / "clips").write_text("mine")
    with pytest.raises(Refused, match=r"cannot write into .*clips: File exists"):
        make_clip(ClipJob(tmp_path / "run", Moment(10**18), 1, 1))
