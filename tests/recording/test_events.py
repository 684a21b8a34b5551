"""Events are stored in the file's metadata at once, and stay there."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.records import Metadata

from robotctl.recording import Recorder, read_info
from robotctl.recording.format.names import EVENT_RECORD, EventKind
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.write import bag_writer
from robotctl.testing.drives import START_NS, TWIST
from tests.support.recordings import read_strictly, write_numbered
from tests.support.waiting import until

EVENTS = (
    RecordedEvent(EventKind.MARK, START_NS, "door \x1b[2J open"),
    RecordedEvent(EventKind.EMERGENCY_STOP, START_NS + 1, "requested"),
    RecordedEvent(EventKind.ERROR, START_NS + 2, ""),
    RecordedEvent(EventKind.DRIVE_ENDED, START_NS + 3, "drive finished: 2 laps", 2, 0.021),
    RecordedEvent(
        EventKind.DRIVE_ENDED, START_NS + 4, "drive finished: 1 lap", 1, 0.02, 0.01, 0.03
    ),
    RecordedEvent(
        EventKind.DRIVE_ENDED,
        START_NS + 5,
        "drive finished: 1 lap",
        1,
        0.02,
        closure_m=0.03,
        true_heading_max_rad=0.1,
        true_closure_m=0.04,
        drive_s=17.25,
    ),
)


def test_an_event_is_found_while_the_file_grows_and_after_it_was_closed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    for event in EVENTS:
        recorder.add_event(event)
    until(lambda: read_info(tmp_path / "run").events == EVENTS)
    stats = recorder.close()
    assert read_info(tmp_path / "run").events == EVENTS
    assert len(read_strictly(stats.file)) == 10


def test_an_event_survives_its_summary(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    recorder.add_event(EVENTS[0])
    path = recorder.close().file
    path.write_bytes(path.read_bytes()[:-30])
    info = read_info(path)
    assert (info.indexed, info.events) == (False, EVENTS[:1])


def test_events_without_end_go_on_in_another_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_writer, "MAX_EVENTS", 5)
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    events = [RecordedEvent(EventKind.MARK, START_NS + n, str(n)) for n in range(12)]
    for event in events:
        recorder.add_event(event)
    recorder.close()
    assert len(list((tmp_path / "run").glob("*.mcap"))) == 3
    assert list(read_info(tmp_path / "run").events) == events


@pytest.mark.parametrize(
    "damage",
    [
        {"kind": "holiday"},
        {"log_ns": "-1"},
        {"log_ns": "1" * 30},
        {"log_ns": "soon"},
        {"laps": "1e9"},
        {"laps": str(10**9)},
        {"cross_track_max_m": "nan"},
        {"true_cross_track_rms_m": "inf"},
        {"true_cross_track_max_m": "far"},
        {"true_closure_m": "nan"},
    ],
)
def test_what_is_no_event_of_ours_is_passed_over(damage: dict[str, str]) -> None:
    values = dict(EVENTS[3].values())
    records = [Metadata(EVENT_RECORD, {**values, **damage}), Metadata(EVENT_RECORD, {})]
    assert events_in([*records, Metadata(EVENT_RECORD, values)]) == [EVENTS[3]]
    assert events_in([Metadata("another", values)]) == []
