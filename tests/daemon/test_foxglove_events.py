"""Changes of the mode and marks as events of Foxglove, where the configuration wants them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robotctl.ipc.client import call
from robotctl.recording.format import foxglove
from tests.support.world import World

NS = 1_000_000_000


@pytest.mark.parametrize("text", ["", "a", "ab", "abc", "abcd", "ü€", "\udcff"])
def test_an_event_is_what_its_definition_says(text: str) -> None:
    types = get_types_from_msg(foxglove.DEFINITION, foxglove.TYPE_NAME)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    data = foxglove.encode_event(3 * NS + 5, 4 * NS, {"event": text, "to": "IDLE"})
    event: Any = store.deserialize_cdr(data, foxglove.TYPE_NAME)
    assert (event.start_time.sec, event.start_time.nanosec) == (3, 5)
    assert (event.end_time.sec, event.end_time.nanosec) == (4, 0)
    shown = text.encode(errors="backslashreplace").decode()
    assert [(pair.key, pair.value) for pair in event.metadata] == [("event", shown), ("to", "IDLE")]


def test_changes_and_marks_are_events_and_the_recording_is_played_and_checked(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(name, world.environment[name])
    world.patient.write_text(f"{world.patient.read_text()}recording.foxglove_events: true\n")
    world.ok("start", "--sim")
    call("robot", "set_mode", {"mode": 3, "source": "a person"})
    call("robot", "mark", {"text": "a mark", "source": "a person"})
    world.ok("stop")
    assert world.robotctl("replay", "last", "--check").exit_code == 0
    (folder,) = world.recordings.iterdir()
    assert [dict(pairs) for pairs in events_of(folder)] == [
        {
            "event": "mode",
            "from": "IDLE",
            "to": "EMERGENCY_STOP",
            "reason": "requested by a person",
            "cause": "operator stop",
        },
        {"event": "mark", "text": "a mark", "by": "a person"},
    ]
    played = json.loads(world.robotctl("replay", "last", "--rate", "max", "--json").out)
    assert "/robotctl/events" in json.dumps(played)


def events_of(folder: Path) -> list[list[tuple[str, str]]]:
    with AnyReader([folder]) as reader:
        (connection,) = (each for each in reader.connections if each.msgtype == foxglove.TYPE_NAME)
        assert connection.topic == "/robotctl/events"
        events: list[Any] = [
            reader.deserialize(data, each.msgtype)
            for each, _, data in reader.messages([connection])
        ]
    return [[(pair.key, pair.value) for pair in event.metadata] for event in events]
