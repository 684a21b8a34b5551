"""A clip is compared with its source: each message, and all else that it took from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest

from robotctl.cli import app
from robotctl.errors import UnreadableFile
from robotctl.kernel.types import Twist
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recorder, RecorderOptions, Recording
from robotctl.recording.format import rosbag2
from robotctl.recording.format.names import (
    CLIP_RECORD,
    EVENT_RECORD,
    INFO_RECORD,
    SOFTWARE_RECORD,
    EventKind,
)
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.clip_origin import compare_with_source
from robotctl.testing.drives import BEGIN_NS, START_NS, TWIST, Written, drive, record
from tests.support.edited_recordings import Contents, contents_of, write_contents
from tests.support.recordings import write_numbered
from tests.support.waiting import until

WRITTEN = drive(3.0, snapshots_s=(0.0, 1.5))
MIDDLE_NS = START_NS + BEGIN_NS + 2 * NS_PER_S


def clip_of(folder: Path, target: Path) -> Path:
    """Cut the second from 1.5 s to 2.5 s."""
    window = (MIDDLE_NS - NS_PER_S // 2, MIDDLE_NS + NS_PER_S // 2)
    with Recording(folder) as recording:
        cut_clip(recording, Moment(MIDDLE_NS), window, target)
    return target


def with_a_faster_command(written: list[Written]) -> list[Written]:
    """Change one command in the middle of the clip."""
    moving = [at for at, each in enumerate(written) if isinstance(each, Twist)]
    at = moving[len(moving) * 2 // 3]
    return [*written[:at], Twist(0.55, 0.0), *written[at + 1 :]]


def test_a_clip_holds_what_its_source_holds(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    origin = compare_with_source(clip_of(folder, tmp_path / "clip.mcap"), folder)
    assert origin.wrong == []
    assert origin.messages > 100


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


def clip_of_the_mark(folder: Path, target: Path) -> Path:
    window = (MIDDLE_NS - NS_PER_S // 2, MIDDLE_NS + NS_PER_S // 2)
    with Recording(folder) as recording:
        moment = Moment.of(recording.info().events[1])
        cut_clip(recording, moment, window, target)
    return target


def values_of(contents: Contents, record: str) -> dict[str, str]:
    return next(values for name, values in contents.metadata if name == record)


def edit_the_definition(contents: Contents) -> None:
    channel, schema = contents.types[0]
    contents.types[0] = (channel, replace(schema, data=schema.data + b"\nbool more"))


def edit_the_qos(contents: Contents) -> None:
    channel, schema = contents.types[0]
    channel = replace(channel, metadata=channel.metadata | {"offered_qos_profiles": ""})
    contents.types[0] = (channel, schema)


def remove_the_event(contents: Contents) -> None:
    contents.metadata = [each for each in contents.metadata if each[0] != EVENT_RECORD]


def add_an_event(contents: Contents) -> None:
    event = RecordedEvent(EventKind.ERROR, MIDDLE_NS, "the battery was empty")
    contents.metadata.append((EVENT_RECORD, dict(event.values())))


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
        remove_the_event,
        "a metadata record robotctl.event of its source is missing",
    ),
    "an event is added": (
        add_an_event,
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
    contents = contents_of(clip_of_the_mark(folder, tmp_path / "clip.mcap"))
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


def test_a_clip_stays_that_of_a_recording_that_goes_on(tmp_path: Path) -> None:
    """Later files have other metadata, events and channels."""
    heads = count()
    recorder = Recorder(
        tmp_path / "run", metadata=lambda: {"head": str(next(heads))}, on_failure=pytest.fail
    )
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 200))
    until(lambda: recorder.stats().queued == 0)
    recorder.split()
    until(lambda: len(list((tmp_path / "run").glob("*.mcap"))) == 2)
    with Recording(tmp_path / "run" / "run_0.mcap") as recording:
        info = recording.info()
        window = (info.start_ns, info.end_ns)
        cut_clip(recording, Moment(info.end_ns), window, tmp_path / "clip.mcap")
    recorder.add_event(RecordedEvent(EventKind.MARK, info.end_ns, "in the next file"))
    later = recorder.add_topic(replace(TWIST, name="/later"))
    write_numbered(recorder, later, range(300, 400))
    recorder.close()
    origin = compare_with_source(tmp_path / "clip.mcap", tmp_path / "run")
    assert (origin.wrong, origin.messages) == ([], 199)
    assert "what the clip was cut for" in origin.not_proved


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
