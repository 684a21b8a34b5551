"""What `find` answers is what the MCAP files say, read by another library without robotctl."""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from robotctl.collection import catalogue as catalogues
from robotctl.collection.catalogue import Catalogue, catalogue_of
from robotctl.collection.indexing import index_recording
from robotctl.collection.questions import find
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.recording import Recorder, Topic
from robotctl.testing.drives import BEGIN_NS, GID, drive, drive_requested, record

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")

Row = dict[str, Any]
Tables = dict[str, list[Row]]

MODES = ("IDLE", "MOVING", "ERROR", "EMERGENCY_STOP")


class Scans:
    """Every second message of a topic is missing."""

    def __init__(self) -> None:
        self._calls = 0

    def __call__(self, recorder: Recorder, time_ns: int) -> None:
        if self._calls == 0:
            self._channel = recorder.add_topic(Topic("/scan", "std_msgs/msg/String"))
        if self._calls % 40 == 0:
            sequence = self._calls // 20
            recorder.write(self._channel, b"\0\1\0\0\1\0\0\0\0", time_ns, time_ns, sequence, GID)
        self._calls += 1


def at(seconds: float) -> int:
    return BEGIN_NS + round(seconds * 1e9)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some laps, an emergency stop with a refusal, two drives, a lost robot, and no drive."""
    folder = tmp_path_factory.mktemp("sample")
    small = Pattern(PatternKind.CIRCLE, 0.2, 0.2)
    circle = Pattern(PatternKind.CIRCLE, 0.5, 0.4)
    laps = DriveRequested(at(0.1), 1, small, 2, False, "operator")
    stop = ModeRequested(at(2.0), 2, 3, "robotctl estop")
    refused = ModeRequested(at(2.5), 3, 1, "operator")
    then = DriveRequested(at(3.0), 2, circle, 0, False, "a script")
    end = ModeRequested(at(5.0), 3, 0, "operator")
    one = DriveRequested(at(0.1), 1, circle, 0, False, "operator")
    halt = ModeRequested(at(2.0), 4, 0, "operator")
    record(folder / "laps", drive(14.0, requests=[laps]), robot="one")
    record(folder / "stopped", drive(3.0, requests=[drive_requested(), stop, refused]))
    record(folder / "two", drive(6.0, requests=[one, halt, then, end]), robot="two")
    record(folder / "scans", drive(2.0), beside=Scans())
    record(folder / "idle", drive(1.0, requests=[]))
    return folder


@pytest.fixture(scope="module")
def answered(folder: Path) -> Iterator[Catalogue]:
    with pytest.MonkeyPatch.context() as patched:

        def index_here(recordings: list[Path], *_: object) -> dict[Path, str]:
            return {each: said for each in recordings if (said := index_recording(each))}

        patched.setattr(catalogues, "index_recordings", index_here)
        with catalogue_of(folder) as catalogue:
            yield catalogue


@pytest.fixture(scope="module")
def told(folder: Path) -> Tables:
    tables: Tables = {"recordings": [], "drives": [], "events": [], "topics": []}
    for recording in sorted(folder.iterdir()):
        if recording.is_dir():
            for table, rows in read_by_hand(recording).items():
                tables[table] += [{"recording": recording.name, **row} for row in rows]
    return tables


def read_by_hand(recording: Path) -> Tables:
    """Return the rows of a recording: of its messages, its journal and its ledger."""
    (file,) = recording.glob("*.mcap")
    counted: Counter[str] = Counter()
    types, journal, log_ns = {}, [], []
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            counted[channel.topic] += 1
            types[channel.topic] = schema.name
            log_ns.append(message.log_time)
            if channel.topic == "/robotctl/journal":
                journal.append((message.log_time, *entry_of(message.data)))
        records = [(each.name, each.metadata) for each in reader.iter_metadata()]
    metadata = dict(records)
    lost = {topic: json.loads(text) for topic, text in metadata["robotctl.ledger"].items()}
    drives, events = drives_and_events(journal, metadata["robotctl"]["robot"])
    events += [
        event(int(values["log_ns"]), values["kind"], None, values["text"], None)
        for name, values in records
        if name == "robotctl.event"
    ]
    seconds = (max(log_ns) - min(log_ns)) / 1e9
    row = {
        "robot": metadata["robotctl"]["robot"],
        "start_ns": min(log_ns),
        "duration_s": seconds,
        "size_bytes": file.stat().st_size,
        "files": 1,
        "messages": len(log_ns),
        "lost": sum(each["dropped"] + each["lost"] for each in lost.values()),
        "drives": len(drives),
        "laps": sum(each["laps"] for each in drives if each["laps"] is not None),
        "distance_m": sum(each["distance_m"] or 0.0 for each in drives),
        "max_error_m": max(
            (each["max_error_m"] for each in drives if each["laps"] is not None), default=None
        ),
        "stops": sum(each["mode"] in MODES[2:] for each in events if each["event"] == "mode"),
        "check": "same",
        "verify": "whole",
    }
    topics = [
        {
            "topic": topic,
            "type": types[topic],
            "messages": count,
            "lost": lost[topic]["dropped"] + lost[topic]["lost"],
            "rate_hz": count / seconds,
        }
        for topic, count in counted.items()
    ]
    return {"recordings": [row], "drives": drives, "events": events, "topics": topics}


def entry_of(data: bytes) -> tuple[str, Row]:
    """Return name and fields of a journal entry in CDR: two texts, the first after 24 bytes."""
    name, end = text_at(data, 24)
    fields, _ = text_at(data, end + -end % 4)
    return name, json.loads(fields)


def text_at(data: bytes, begin: int) -> tuple[str, int]:
    """Return a text, which its length precedes, and where it ends."""
    (size,) = struct.unpack_from("<I", data, begin)
    end = begin + 4 + size
    return data[begin + 4 : end - 1].decode(), end


def drives_and_events(
    journal: list[tuple[int, str, Row]], robot: str
) -> tuple[list[Row], list[Row]]:
    drives: dict[int, Row] = {}
    events: list[Row] = []
    asked: dict[int, Row] = {}
    for log_ns, name, fields in journal:
        if name == "DriveRequested":
            asked[fields["request_id"]] = fields | {"log_ns": log_ns}
        elif name == "ModeChanged":
            mode = MODES[fields["mode"]]
            events.append(event(log_ns, "mode", mode, fields["reason"], fields["cause"]))
        elif name == "Reply" and not fields["ok"]:
            mode = MODES[fields["mode"]]
            events.append(event(log_ns, "refusal", mode, fields["message"], None))
        elif name == "Reply" and fields["request_id"] in asked:
            request = asked[fields["request_id"]]
            drives[fields["request_id"]] = {
                "drive": len(drives) + 1,
                "robot": robot,
                "start_ns": request["log_ns"],
                "pattern": request["pattern"]["kind"],
                "wanted_laps": request["laps"],
                "asked_by": request["source"],
                **dict.fromkeys(END),
            }
        elif name == "DriveEnded":
            report = {
                key: None if value == "nan" else value for key, value in fields["report"].items()
            }
            drives[fields["request_id"]] |= {
                "completed": fields["completed"],
                "ended": fields["reason"],
                "cause": fields["cause"],
                **{column: report[key] for column, key in REPORTED.items()},
            }
    return list(drives.values()), events


REPORTED = {
    "duration_s": "duration_s",
    "laps": "laps",
    "distance_m": "distance_m",
    "rms_error_m": "cross_track_rms_m",
    "max_error_m": "cross_track_max_m",
    "closure_m": "closure_m",
    "rms_heading_rad": "heading_rms_rad",
    "max_heading_rad": "heading_max_rad",
}
END = ("completed", "ended", "cause", *REPORTED)


def event(log_ns: int, kind: str, mode: str | None, text: str, cause: str | None) -> Row:
    return {"event": kind, "start_ns": log_ns, "mode": mode, "text": text, "cause": cause}


def rows_of(catalogue: Catalogue, table: str, condition: str) -> list[Row]:
    return find(catalogue, table, condition, "recording").as_objects()


def sorted_rows(rows: list[Row], columns: tuple[str, ...]) -> list[Row]:
    """Return these columns of rows, in an order of their own; a time to a microsecond."""
    chosen = [{name: row[name] for name in columns} for row in rows]
    for row in chosen:
        if "start_ns" in row:
            row["start_ns"] = round(row["start_ns"], -3)
    return sorted(chosen, key=lambda row: [str(value) for value in row.values()])


@pytest.mark.parametrize("table", ["recordings", "drives", "events", "topics"])
def test_every_column_is_what_the_files_say(answered: Catalogue, told: Tables, table: str) -> None:
    columns = tuple(told[table][0])
    found = [row for row in rows_of(answered, table, "") if row.get("messages") != 0]
    expected = sorted_rows(told[table], columns)
    assert len(expected) >= 5
    assert sorted_rows(found, columns) == expected


def more(value: float | None, than: float) -> bool:
    return value is not None and value > than


CONDITIONS: list[tuple[str, str, Callable[[Row], bool]]] = [
    ("drives", "laps >= 2", lambda row: more(row["laps"], 1)),
    (
        "drives",
        "laps >= 1 and max_error_m > 0.001",
        lambda row: more(row["laps"], 0) and more(row["max_error_m"], 0.001),
    ),
    ("drives", "not completed", lambda row: row["completed"] is False),
    ("drives", "ended == None", lambda row: row["ended"] is None),
    ("drives", "distance_m * 2 > 1.7", lambda row: more(row["distance_m"], 0.85)),
    (
        "drives",
        "pattern == 'circle' or asked_by != 'operator'",
        lambda row: row["pattern"] == "circle" or row["asked_by"] != "operator",
    ),
    ("drives", "wanted_laps == 2 and robot == 'one'", lambda row: row["wanted_laps"] == 2),
    ("events", "mode == 'EMERGENCY_STOP'", lambda row: row["mode"] == "EMERGENCY_STOP"),
    ("events", "event == 'refusal'", lambda row: row["event"] == "refusal"),
    ("events", "cause != None", lambda row: row["cause"] is not None),
    ("topics", "lost > 0", lambda row: row["lost"] > 0),
    (
        "topics",
        "messages >= 100 and rate_hz < 60",
        lambda row: row["messages"] >= 100 and row["rate_hz"] < 60,
    ),
    ("recordings", "laps >= 2 and lost == 0", lambda row: row["laps"] >= 2 and row["lost"] == 0),
    (
        "recordings",
        "stops > 0 or max_error_m == None",
        lambda row: row["stops"] > 0 or row["max_error_m"] is None,
    ),
    ("recordings", "0 < duration_s / (1 + 1) < 1.1", lambda row: row["duration_s"] < 2.2),
]


@pytest.mark.parametrize(("table", "condition", "holds"), CONDITIONS)
def test_a_condition_finds_what_a_search_of_the_files_finds(
    answered: Catalogue, told: Tables, table: str, condition: str, holds: Callable[[Row], bool]
) -> None:
    columns = ("recording", "topic" if table == "topics" else "start_ns")
    expected = [row for row in told[table] if holds(row)]
    found = [row for row in rows_of(answered, table, condition) if row.get("messages") != 0]
    assert 0 < len(expected) < len(told[table])
    assert sorted_rows(found, columns) == sorted_rows(expected, columns)
