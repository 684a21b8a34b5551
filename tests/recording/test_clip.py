"""A clip stands alone: it holds its window, latched messages, and a journal that can be checked."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from robotctl.errors import Refused
from robotctl.kernel.types import Twist
from robotctl.messages.motion import encode_twist
from robotctl.recording import Recorder, RecorderOptions, Recording, Topic, read_info, read_messages
from robotctl.recording.disk.storage import DiskFile
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode, encode
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import Clip, Moment, cut_clip
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.testing.drives import BEGIN_NS, GID, JOURNAL, QOS, START_NS, TWIST, Written, drive
from tests.support.bags import LATCHED, STRING, VOLATILE, Line, text, write_bag
from tests.support.recordings import read_strictly
from tests.support.waiting import until, until_longer

DURATION_S = 40.0
MAP = Topic("/map", STRING, "string data\n", "", QOS.replace(": volatile", ": transient_local"))
EVENT = RecordedEvent(EventKind.ERROR, 0, "odometry lost")


def at_ns(seconds: float) -> int:
    """Return a log time, `seconds` after the beginning."""
    return START_NS + BEGIN_NS + round(seconds * 1e9)


@pytest.fixture(scope="module")
def driven() -> list[Written]:
    return drive(DURATION_S, snapshots_s=(0.0, 30.0))


def record(folder: Path, driven: list[Written], *splits_s: float) -> Recorder:
    """Record a drive with its commands, two maps, and an event every 10 s; do not close the
    recorder.
    """
    begun: list[Path] = []
    recorder = Recorder(
        folder,
        RecorderOptions(chunk_bytes=1 << 14),
        metadata=lambda: {"robot": "robot", "mode": "IDLE"},
        on_failure=pytest.fail,
        on_split=begun.append,
    )
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
                count = len(begun)
                recorder.split()
                until_longer(begun, count)
        else:
            assert isinstance(each, Twist)
            published += 1
            recorder.write(commands, encode_twist(each), log_ns, log_ns, published, GID)
    for seconds in range(10, 40, 10):
        recorder.add_event(RecordedEvent(EventKind.MARK, at_ns(seconds), f"at {seconds}"))
    return recorder


@pytest.fixture(scope="module")
def recording(driven: list[Written], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "run"
    record(folder, driven, 12.0, 24.0).close()
    return folder


def clip(source: Path, target: Path, start_s: float, end_s: float) -> Clip:
    with Recording(source) as recording:
        return cut_clip(recording, Moment(at_ns(start_s)), (at_ns(start_s), at_ns(end_s)), target)


@pytest.mark.parametrize("window", [(5.0, 10.0), (20.0, 35.0), (31.0, 32.0), (12.0, 24.0)])
def test_a_clip_holds_its_window_and_what_is_latched(
    recording: Path, tmp_path: Path, window: tuple[float, float]
) -> None:
    target = tmp_path / "clip.mcap"
    made = clip(recording, target, *window)
    start_ns, end_ns = made.start_ns, made.end_ns
    assert (start_ns, end_ns) == (at_ns(window[0]), at_ns(window[1]))
    stored = read_strictly(target)
    assert len(stored) == made.message_count == read_info(target).message_count
    whole = [m for m in read_messages(recording) if start_ns <= m.log_ns <= end_ns]
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


def test_a_clip_holds_once_what_a_file_repeats_before_it_came(tmp_path: Path) -> None:
    """A new file begins with the last latched message, also where the writer lags behind it."""
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    maps, commands = recorder.add_topic(MAP), recorder.add_topic(TWIST)
    for data, log_s, publish_s, sequence in (("b", 1, 3, 2), ("a", 2, 2, 1), ("b", 3, 3, 2)):
        recorder.write(maps, text(data), at_ns(log_s), at_ns(publish_s), sequence, b"a")
    recorder.write(commands, encode_twist(Twist(0.0, 0.0)), at_ns(5), at_ns(5), 1, GID)
    recorder.close()
    clip(tmp_path / "run", tmp_path / "clip.mcap", 4.0, 6.0)
    stored = read_strictly(tmp_path / "clip.mcap")
    assert [each.data for each in stored if each.topic == "/map"] == [text("a"), text("b")]


def test_a_clip_says_of_what_it_is_one(recording: Path, tmp_path: Path) -> None:
    target = tmp_path / "clip.mcap"
    with Recording(recording) as source:
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


@settings(max_examples=25)
@given(start_s=st.floats(0.0, DURATION_S), length_s=st.floats(0.05, 10.0))
def test_whatever_is_cut_a_fresh_kernel_decides_it_the_same(
    recording: Path, tmp_path_factory: pytest.TempPathFactory, start_s: float, length_s: float
) -> None:
    target = tmp_path_factory.mktemp("clips") / "clip.mcap"
    clip(recording, target, start_s, start_s + length_s)
    report = check_recording(target)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert report.events > 0


def test_a_clip_of_a_clip_is_one_as_well(recording: Path, tmp_path: Path) -> None:
    outer, inner = tmp_path / "outer.mcap", tmp_path / "inner.mcap"
    clip(recording, outer, 10, 30)
    clip(outer, inner, 15, 20)
    assert check_recording(inner).verdict is Verdict.SAME
    assert read_info(inner).metadata["robotctl.clip"]["of"] == "outer.mcap"


def test_a_recording_that_goes_on_can_be_cut(driven: list[Written], tmp_path: Path) -> None:
    recorder = record(tmp_path / "run", driven)
    try:
        until(lambda: recorder.stats().queued == 0)
        made = clip(tmp_path / "run", tmp_path / "clip.mcap", 20, 25)
    finally:
        recorder.close()
    assert made.lost == ()
    assert check_recording(made.target).verdict is Verdict.SAME


def test_recordings_of_others_are_cut_without_a_journal(tmp_path: Path) -> None:
    lines = [Line("/map", STRING, 0, text("map"), LATCHED)]
    lines += [Line("/talk", STRING, 100.0 * n, text(str(n)), VOLATILE) for n in range(1, 50)]
    source = write_bag(tmp_path / "theirs.mcap", lines, chunk_bytes=256)
    with Recording(source) as recording:
        start_ns = recording.info().start_ns
        window = (start_ns + 1_000_000_000, start_ns + 2_000_000_000)
        made = cut_clip(recording, Moment(start_ns), window, tmp_path / "clip.mcap")
    assert made.lost == ()
    assert [m.data for m in read_strictly(made.target)] == [
        text("map"),
        *(text(str(n)) for n in range(10, 21)),
    ]


def test_names_that_are_no_text_are_written_escaped(tmp_path: Path) -> None:
    lines = [Line("/talk", STRING, 100.0 * n, text(str(n)), VOLATILE) for n in range(1, 5)]
    source = write_bag(tmp_path / os.fsdecode(b"caf\xe9.mcap"), lines)
    target = tmp_path / os.fsdecode(b"clip-caf\xe9.mcap")
    with Recording(source) as recording:
        made = cut_clip(recording, Moment(recording.info().start_ns), (0, 1 << 63), target)
    assert len(read_strictly(made.target)) == 4
    assert read_info(target).metadata["robotctl.clip"]["of"] == r"caf\udce9.mcap"


def test_a_time_without_messages_is_refused(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="has no messages in that time range"):
        clip(recording, tmp_path / "clip.mcap", 100, 200)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_already_is_not_overwritten(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "clip.mcap").write_text("mine")
    with pytest.raises(Refused, match="File exists"):
        clip(recording, tmp_path / "clip.mcap", 5, 10)
    assert (tmp_path / "clip.mcap").read_text() == "mine"


def test_a_disk_that_fails_leaves_no_half_clip(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(DiskFile, "sync", fail)
    with pytest.raises(Refused, match="No space left"):
        clip(recording, tmp_path / "clip.mcap", 5, 10)
    assert list(tmp_path.iterdir()) == []


def test_what_of_the_window_cannot_be_read_is_said(driven: list[Written], tmp_path: Path) -> None:
    path = record(tmp_path / "run", driven).close().file
    with Recording(path) as source:
        places = [p for p in source._files[0].index.places if at_ns(20) <= p.start_ns < at_ns(21)]
    data = bytearray(path.read_bytes())
    data[places[0].offset + places[0].length - 5] ^= 0xFF
    path.write_bytes(data)
    made = clip(path, tmp_path / "clip.mcap", 19, 25)
    (lost,) = made.lost
    assert "are lost" in lost
    assert read_info(made.target).metadata["robotctl.clip"]["lost"] == lost
    assert clip(path, tmp_path / "other.mcap", 31, 35).lost == ()
