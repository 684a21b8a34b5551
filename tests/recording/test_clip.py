"""A clip stands alone: it holds its window, latched messages, and a journal that can be checked.

A clip of a live recording waits for the end of its window, and no longer.
A clip is compared with its source: each message, and all else that it took from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Metadata
from rosbags.highlevel import AnyReader

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.cli import app
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import encode_twist
from robotctl.recording import Recorder, RecorderOptions, Recording, Topic, read_info, read_messages
from robotctl.recording.format import rosbag2
from robotctl.recording.format.disk import DiskFile
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode, encode
from robotctl.recording.format.names import (
    CLIP_RECORD,
    EVENT_RECORD,
    INFO_RECORD,
    SOFTWARE_RECORD,
    EventKind,
)
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import (
    Clip,
    ClipJob,
    Moment,
    cut_clip,
    make_clip,
    records_of_clip,
    remaining_s,
)
from robotctl.recording.keep.clip_origin import compare_with_source
from robotctl.recording.keep.listing import list_recording
from robotctl.testing.drives import (
    BEGIN_NS,
    GID,
    JOURNAL,
    QOS,
    START_NS,
    TWIST,
    Written,
    drive,
    record,
)
from tests.support.bags import STRING, text
from tests.support.cases import for_each
from tests.support.edited_recordings import Contents, contents_of, write_contents
from tests.support.recordings import Tape, flip, numbered, read_strictly
from tests.support.waiting import until_longer

DURATION_S = 40.0
MAP = Topic("/map", STRING, "string data\n", "", QOS.replace(": volatile", ": transient_local"))
EVENT = RecordedEvent(EventKind.ERROR, 0, "odometry lost")


def at_ns(seconds: float) -> int:
    """Return a log time, `seconds` after the beginning."""
    return START_NS + BEGIN_NS + round(seconds * 1e9)


@pytest.fixture(scope="module")
def driven() -> list[Written]:
    return drive(DURATION_S, snapshots_s=(0.0, 30.0))


def record_drive(folder: Path, driven: list[Written], *splits_s: float) -> Recorder:
    """Record a drive with commands, two maps, and an event every 10 s; leave the recorder open."""
    named = {"robot": "robot", "mode": "IDLE"}
    recorder = Tape(folder, chunk_bytes=1 << 14, metadata=named.copy)
    journal, commands, maps = (recorder.add_topic(topic) for topic in (JOURNAL, TWIST, MAP))
    recorder.write(maps, text("old"), at_ns(0), at_ns(0), 1, b"a")
    recorder.write(maps, text("other"), at_ns(0.5), at_ns(0), 1, b"b")
    log_ns, published, splits, new = 0, 0, list(splits_s), [25.0]
    for each in driven:
        if isinstance(each, JournalEntry):
            log_ns = START_NS + each.t_ns
            recorder.write(journal, encode(each), log_ns, log_ns, each.seq + 1, GID)
            if new and log_ns >= at_ns(new[0]):
                recorder.write(maps, text("new"), at_ns(new.pop()), at_ns(25), 2, b"a")
            if splits and log_ns >= at_ns(splits[0]):
                splits.pop(0)
                count = len(recorder.begun)
                recorder.split()
                until_longer(recorder.begun, count)
        else:
            assert isinstance(each, Twist)
            published += 1
            recorder.write(commands, encode_twist(each), log_ns, log_ns, published, GID)
    for seconds in range(10, 40, 10):
        recorder.add_event(RecordedEvent(EventKind.MARK, at_ns(seconds), f"at {seconds}"))
    return recorder


@pytest.fixture(scope="module")
def driven_recording(driven: list[Written], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "run"
    record_drive(folder, driven, 12.0, 24.0).close()
    return folder


def clip(source: Path, target: Path, start_s: float, end_s: float) -> Clip:
    with Recording(source) as recording:
        return cut_clip(recording, Moment(at_ns(start_s)), (at_ns(start_s), at_ns(end_s)), target)


@pytest.mark.parametrize("window", [(5.0, 10.0), (20.0, 35.0), (31.0, 32.0), (12.0, 24.0)])
def test_a_clip_holds_its_window_and_what_is_latched(
    driven_recording: Path, tmp_path: Path, window: tuple[float, float]
) -> None:
    target = tmp_path / "clip.mcap"
    made = clip(driven_recording, target, *window)
    start_ns, end_ns = made.start_ns, made.end_ns
    assert (start_ns, end_ns) == (at_ns(window[0]), at_ns(window[1]))
    stored = read_strictly(target)
    assert len(stored) == made.message_count == read_info(target).message_count
    whole = [m for m in read_messages(driven_recording) if start_ns <= m.log_ns <= end_ns]
    for topic in ("/cmd_vel", "/robotctl/journal"):
        assert [(m.data, m.log_ns, m.sequence) for m in stored if m.topic == topic][
            -sum(m.topic == topic for m in whole) :
        ] == [(m.data, m.log_ns, m.sequence) for m in whole if m.topic == topic]
    assert all(m.log_ns >= start_ns for m in stored if m.topic != "/robotctl/journal")
    maps = [m.data for m in stored if m.topic == "/map" and m.log_ns == start_ns]
    assert {text("other"), text("new" if window[0] > 25 else "old")} <= set(maps)
    assert maps[-1] == text("new" if window[0] > 25 else "other")
    first = next(m for m in stored if m.topic == "/robotctl/journal")
    assert decode(first.data).kind is EntryKind.SNAPSHOT


def test_a_clip_says_of_what_it_is_one(driven_recording: Path, tmp_path: Path) -> None:
    target = tmp_path / "clip.mcap"
    with Recording(driven_recording) as source:
        moment = Moment.of(source.info().events[1])
        cut_clip(source, moment, (at_ns(15), at_ns(25)), target)
    info = read_info(target)
    assert info.metadata["robotctl.clip"] == {
        "of": "run_0.mcap, run_1.mcap, run_2.mcap",
        "event": "mark",
        "event_ns": str(at_ns(20)),
        "text": "at 20",
        "start_ns": str(at_ns(15)),
        "end_ns": str(at_ns(25)),
        "lost": "",
    }
    assert info.metadata["robotctl"] == {"robot": "robot"}
    assert [event.text for event in info.events] == ["at 20"]
    assert "robotctl.ledger" not in info.metadata
    with AnyReader([target]) as bag:
        assert {each.topic for each in bag.connections} == {t.name for t in info.topics}
        assert bag.message_count == info.message_count


@settings(max_examples=8)
@given(start_s=st.floats(0.0, DURATION_S), length_s=st.floats(0.05, 10.0))
def test_whatever_is_cut_a_fresh_kernel_decides_it_the_same(
    driven_recording: Path,
    tmp_path_factory: pytest.TempPathFactory,
    start_s: float,
    length_s: float,
) -> None:
    target = tmp_path_factory.mktemp("clips") / "clip.mcap"
    clip(driven_recording, target, start_s, start_s + length_s)
    report = check_recording(target)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert report.events > 0


def test_a_time_without_messages_is_refused(driven_recording: Path, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="has no messages in that time range"):
        clip(driven_recording, tmp_path / "clip.mcap", 100, 200)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_already_is_not_overwritten(driven_recording: Path, tmp_path: Path) -> None:
    (tmp_path / "clip.mcap").write_text("mine")
    with pytest.raises(Refused, match="File exists"):
        clip(driven_recording, tmp_path / "clip.mcap", 5, 10)
    assert (tmp_path / "clip.mcap").read_text() == "mine"


def test_a_disk_that_fails_leaves_no_half_clip(
    driven_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(DiskFile, "sync", fail)
    with pytest.raises(Refused, match="No space left"):
        clip(driven_recording, tmp_path / "clip.mcap", 5, 10)
    assert list(tmp_path.iterdir()) == []


def test_what_of_the_window_cannot_be_read_is_said(driven: list[Written], tmp_path: Path) -> None:
    path = record_drive(tmp_path / "run", driven).close().file
    with Recording(path) as source:
        places = [p for p in source._files[0].index.places if at_ns(20) <= p.start_ns < at_ns(21)]
    flip(path, places[0].offset + places[0].length - 5)
    made = clip(path, tmp_path / "clip.mcap", 19, 25)
    (lost,) = made.lost
    assert "are lost" in lost
    assert read_info(made.target).metadata["robotctl.clip"]["lost"] == lost
    assert clip(path, tmp_path / "other.mcap", 31, 35).lost == ()


def test_what_comes_after_the_event_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.recording.keep.clip.PATIENCE_S", 30.0)
    recorder = Tape(tmp_path / "run")
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


@pytest.mark.parametrize("ahead_s", [0, 3600], ids=["fallen silent", "the clock was set back"])
def test_what_may_never_come_is_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead_s: int
) -> None:
    monkeypatch.setattr("robotctl.recording.keep.clip.PATIENCE_S", 0.2)
    at_ns = time.time_ns() + ahead_s * NS_PER_S
    recorder = Tape(tmp_path / "run")
    try:
        recorder.write(recorder.add_topic(TWIST), numbered(0), at_ns, 0, 0, GID)
        job = ClipJob(tmp_path / "run", Moment(at_ns), before_s=5.0, after_s=0.3)
        assert make_clip(job).message_count == 1
    finally:
        recorder.close()


def test_a_file_in_the_place_of_the_folder_of_clips_is_named(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    recorder.write(recorder.add_topic(TWIST), numbered(0), 10**18, 0, 0, GID)
    recorder.close()
    (tmp_path / "run" / "clips").write_text("mine")
    with pytest.raises(Refused, match=r"cannot write into .*clips: File exists"):
        make_clip(ClipJob(tmp_path / "run", Moment(10**18), 1, 1))


WRITTEN = drive(3.0, snapshots_s=(0.0, 1.5))
MIDDLE_NS = START_NS + BEGIN_NS + 2 * NS_PER_S


def clip_of(folder: Path, target: Path, moment: Moment | None = None) -> Path:
    """Cut the second from 1.5 s to 2.5 s."""
    window = (MIDDLE_NS - NS_PER_S // 2, MIDDLE_NS + NS_PER_S // 2)
    with Recording(folder) as recording:
        cut_clip(recording, moment or Moment(MIDDLE_NS), window, target)
    return target


def with_a_faster_command(written: list[Written]) -> list[Written]:
    """Change one command in the middle of the clip."""
    moving = [at for at, each in enumerate(written) if isinstance(each, Twist)]
    at = moving[len(moving) * 2 // 3]
    return [*written[:at], Twist(0.55, 0.0), *written[at + 1 :]]


def test_a_clip_of_a_recording_that_was_changed_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    changed = record(tmp_path / "changed" / "run", with_a_faster_command(WRITTEN))
    clip = clip_of(changed, tmp_path / "clip.mcap")
    (sentence,) = compare_with_source(clip, folder).wrong
    assert "/cmd_vel is not the one of its source" in sentence
    assert app.run(["verify", str(clip), "--source", str(folder)]) == 7
    assert app.run(["verify", str(clip), "--source", str(changed)]) == 4  # it is not sealed
    assert "messages are those of" in capsys.readouterr().out


def record_events(folder: Path) -> Path:
    """Make a recording with software, a mark within the clip and one before it."""

    def mark(recorder: Recorder, time_ns: int) -> None:
        while marks and marks[0] <= time_ns:
            at_ns = marks.pop(0)
            recorder.add_event(RecordedEvent(EventKind.MARK, at_ns, f"mark at {at_ns}"))

    marks = [MIDDLE_NS - NS_PER_S, MIDDLE_NS]
    options = RecorderOptions(records={SOFTWARE_RECORD: {"digest": "abc"}})
    return record(folder, WRITTEN, options=options, beside=mark)


def values_of(contents: Contents, record: str) -> dict[str, str]:
    return next(values for name, values in contents.metadata if name == record)


def edit_the_definition(contents: Contents) -> None:
    channel, schema = contents.types[0]
    contents.types[0] = (channel, replace(schema, data=schema.data + b"\nbool more"))


def edit_the_qos(contents: Contents) -> None:
    channel, schema = contents.types[0]
    channel = replace(channel, metadata=channel.metadata | {"offered_qos_profiles": ""})
    contents.types[0] = (channel, schema)


ADDED = RecordedEvent(EventKind.ERROR, MIDDLE_NS, "the battery was empty")
EDITS: dict[str, tuple[Callable[[Contents], object], str]] = {
    "the version": (
        lambda clip: values_of(clip, INFO_RECORD).update(robotctl="0.1.0"),
        "its metadata record robotctl is not one of its source",
    ),
    "a parameter is removed": (
        lambda clip: values_of(clip, INFO_RECORD).pop("parameter.limits.linear_mps"),
        "its metadata record robotctl is not one of its source",
    ),
    "the software": (
        lambda clip: values_of(clip, SOFTWARE_RECORD).update(digest="def"),
        "its metadata record robotctl.software is not one of its source",
    ),
    "the text of an event": (
        lambda clip: values_of(clip, EVENT_RECORD).update(text="forged"),
        "its metadata record robotctl.event is not one of its source",
    ),
    "an event is removed": (
        lambda clip: clip.metadata.remove(
            next(each for each in clip.metadata if each[0] == EVENT_RECORD)
        ),
        "a metadata record robotctl.event of its source is missing",
    ),
    "an event is added": (
        lambda clip: clip.metadata.append((EVENT_RECORD, dict(ADDED.values()))),
        "its metadata record robotctl.event is not one of its source",
    ),
    "what it was cut for": (
        lambda clip: values_of(clip, CLIP_RECORD).update(event="error", text="forged"),
        "the event that it was cut for is not one of its source",
    ),
    "the fields of a type": (edit_the_definition, "the definition of the type of"),
    "the QoS of a channel": (edit_the_qos, "the channel of"),
}


@pytest.mark.parametrize(("edit", "sentence"), EDITS.values(), ids=EDITS.keys())
def test_what_a_clip_took_from_its_source_is_compared(
    tmp_path: Path, edit: Callable[[Contents], object], sentence: str
) -> None:
    folder = record_events(tmp_path / "run")
    mark = Moment.of(read_info(folder).events[1])
    contents = contents_of(clip_of(folder, tmp_path / "clip.mcap", mark))
    same = write_contents(tmp_path / "same", contents.copy())
    assert compare_with_source(same, folder).wrong == []
    edit(contents)
    edited = write_contents(tmp_path / "edited", contents)
    assert any(sentence in each for each in compare_with_source(edited, folder).wrong)
    assert app.run(["verify", str(edited), "--source", str(folder)]) == 7


def test_the_rosbag2_record_of_a_clip_is_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    clip = clip_of(folder, tmp_path / "clip.mcap")
    clip = clip.rename(tmp_path / "renamed.mcap")
    assert compare_with_source(clip, folder).wrong == []
    body = rosbag2.serialized_metadata
    monkeypatch.setattr(
        "robotctl.recording.keep.clip.serialized_metadata",
        lambda topics, files: body(topics, files).replace("geometry_msgs", "forged_msgs"),
    )
    forged = clip_of(folder, tmp_path / "forged.mcap")
    assert compare_with_source(forged, folder).wrong == [
        "its rosbag2 record is not what its messages and channels make"
    ]


def test_what_a_conversion_wrote_into_a_clip_is_not_proved(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    clip = clip_of(folder, tmp_path / "clip.mcap")
    assert app.run(["convert", str(clip), str(tmp_path / "copy")]) == 0
    origin = compare_with_source(tmp_path / "copy", folder)
    assert origin.wrong == []
    assert "what robotctl.conversion says: it was written after the clip was cut" in (
        origin.not_proved
    )


def test_what_is_no_clip_or_of_another_file_is_said(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    with pytest.raises(UnreadableFile, match="does not say what it was cut from"):
        compare_with_source(folder, folder)
    other = record(tmp_path / "other", WRITTEN)
    clip = clip_of(other, tmp_path / "clip.mcap")
    assert compare_with_source(clip, folder).wrong == [
        "it was cut from other_0.mcap, which is not there"
    ]


@for_each(("mode", "kept"), [("MOVING", {}), ("observing", {"mode": "observing"})])
def test_of_the_modes_a_clip_keeps_that_of_an_observer(mode: str, kept: dict[str, str]) -> None:
    (copied,) = records_of_clip([Metadata("robotctl", {"mode": mode})], (0, 1))
    assert copied == ("robotctl", kept)
