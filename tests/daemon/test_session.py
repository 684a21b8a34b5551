"""One run of the daemon from start to stop, and its files; one promise in each test."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Iterator
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import Twist
from rclpy.serialization import deserialize_message
from robot_controller.msg import RobotStatus

from robotctl.check.compare import first_divergence
from robotctl.ipc.answers import Status
from robotctl.recording import read_info
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.format.recorded_events import ERRORS
from robotctl.ros.message_types import message_class
from tests.support.waiting import until
from tests.support.world import PATIENT, Peer, World, journal_of, new_world, read_back

AGILE = f"{PATIENT}limits: {{angular_rps: 4.0, angular_accel_rps2: 10.0}}\n"
"""A small circle takes 3 s."""


class Session:
    """The observations of one run of the daemon."""

    def __init__(self, world: World, peer: Peer) -> None:
        peer("listen")
        self.started = world.ok("start", "--sim", settings=AGILE)
        until(lambda: peer("heard")["commands"])
        self.idle = world.status()
        self.calls = {"moving": peer("set_mode", mode=1)}
        until(lambda: world.status()["velocity"]["linear"] > 0.05)
        self.moving = world.status()
        self.calls["unknown"] = peer("set_mode", mode=7)
        self.calls["idle"] = peer("set_mode", mode=0)
        self.drive = world.answer(
            "drive", "circle", "--radius", "0.15", "--laps", "1", "--speed", "0.4", "--wait"
        )
        self.path = _talk(world, _request("hello", protocol=1), _request("path"))[-1]["result"]
        assert Path(self.drive["picture"]).read_bytes().startswith(b"\x89PNG")
        self.calls["stop"] = peer("set_mode", mode=3)
        self.calls["refused"] = peer("set_mode", mode=1)
        self.late = peer("late_status")
        self.malformed = _talk(world, "{", _request("set_mode", mode=nan))
        world.ok("reset")
        self.before_stop = world.status()
        world.ok("set-mode", "moving")
        self.stopped = world.ok("stop")
        self.processes = world.processes()
        self.log = world.log()
        self.folder = world.recording
        self.topics = read_back(self.folder)
        self.journal = journal_of(self.folder)
        last = self.topics["/cmd_vel"][-1].sequence
        until(lambda: peer("heard")["commands"][-1][0] == last)
        self.heard = peer("heard")


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with new_world() as world, Peer(world) as peer:
        yield Session(world, peer)


def _request(method: str, **params: Any) -> str:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params})


def _talk(world: World, *lines: str) -> list[Any]:
    """Return the answers to lines on one connection."""
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(world.folder / "run" / "robotctl" / "robot.sock"))
        client.sendall("".join(f"{line}\n" for line in lines).encode())
        with client.makefile() as answers:
            return [json.loads(answers.readline()) for _ in lines]


def test_start_prints_what_runs(session: Session) -> None:
    status = session.idle
    for text in (
        "robot robot is ready",
        "mode        IDLE",
        f"domain {status['domain_id']}, discovery LOCALHOST",
        "simulator   yes",
        f"socket      {status['socket']}",
        "recording   recordings/robot_",
        "log         ",
        f"pid         {status['pid']}",
    ):
        assert text in session.started
    assert max(map(len, session.started.splitlines())) <= 100


def test_status_shows_the_present_state(session: Session) -> None:
    assert (session.idle["mode"], session.idle["phase"]) == ("IDLE", "standing")
    assert (session.moving["mode"], session.moving["phase"]) == ("MOVING", "driving")
    assert session.idle["sim"] is True
    assert session.idle["warnings"] == []
    assert 0.99 < session.idle["battery"] <= 1.0
    assert session.idle["recorder"]["state"] == "recording"


def test_drive_wait_returns_the_tracking_numbers(session: Session) -> None:
    drive = session.drive
    assert drive["laps"] == 1
    assert drive["distance_m"] == pytest.approx(2 * 3.1416 * 0.15, rel=0.1)
    assert 0.0 < drive["cross_track_rms_m"] <= drive["cross_track_max_m"] < 0.05
    assert drive["closure_m"] < 0.05
    assert 0.0 < drive["true_cross_track_rms_m"] <= drive["true_cross_track_max_m"] < 0.05
    assert drive["true_cross_track_max_m"] != drive["cross_track_max_m"]


def test_the_recording_holds_every_error_that_the_drive_told(session: Session) -> None:
    events = [each for each in read_info(session.folder).events if each.laps == 1]
    assert [{name: getattr(each, name) for name in ERRORS} for each in events] == [
        {name: session.drive[name] for name in ERRORS}
    ]
    assert [each.drive_s for each in events] == [session.drive["duration_s"]]
    known = [name for name in ERRORS if session.drive[name] is not None]
    assert set(ERRORS) - set(known) <= {"true_closure_m"}  # none if the drive ends with its lap


def test_the_driven_path_lies_on_the_wanted_one(session: Session) -> None:
    for x, y in session.path["driven"]:
        nearest = min((x - a) ** 2 + (y - b) ** 2 for a, b in session.path["reference"])
        assert nearest < 0.05**2
    assert len(session.path["driven"]) > 50


def test_the_service_answers_as_the_command_line_does(session: Session) -> None:
    for number, mode in enumerate(("IDLE", "MOVING")):
        message = f"Mode changed to {mode}"
        answer = {"success": True, "message": message, "current_mode": number}
        assert session.calls[mode.lower()] == answer


@pytest.mark.parametrize(
    ("call", "mode", "said"),
    [
        ("unknown", 1, "0 IDLE, 1 MOVING, 2 ERROR, 3 EMERGENCY_STOP"),
        ("refused", 3, "robotctl reset"),
    ],
)
def test_the_service_refuses_what_is_no_mode_and_names_why_an_emergency_stop_holds(
    session: Session, call: str, mode: int, said: str
) -> None:
    answer = session.calls[call]
    assert (answer["success"], answer["current_mode"]) == (False, mode)
    assert said in answer["message"]


def test_a_late_subscriber_learns_the_mode(session: Session) -> None:
    mode, number = session.late
    assert mode == 3
    assert number <= session.topics["/robot_status"][-1].sequence


def test_nonsense_on_the_socket_is_answered_and_changes_nothing(session: Session) -> None:
    assert [answer["error"]["code"] for answer in session.malformed] == [-32700, -32700]
    assert session.before_stop["mode"] == "IDLE"


@pytest.mark.parametrize("topic", ["/cmd_vel", "/odom", "/battery_state", "/robot_status"])
def test_every_message_is_recorded_from_the_first_to_the_last(session: Session, topic: str) -> None:
    sequence = [message.sequence for message in session.topics[topic]]
    assert sequence == list(range(1, len(sequence) + 1))


def test_every_call_of_the_service_is_recorded_with_its_answer(session: Session) -> None:
    kind = message_class("robot_controller/srv/SetMode_Event")
    messages = session.topics["/set_mode/_service_event"]
    events = [deserialize_message(message.data, kind) for message in messages]
    answers = [event.response[0].message for event in events if event.response]
    assert sorted(answers) == sorted(call["message"] for call in session.calls.values())
    assert len([event for event in events if event.request]) == len(answers)


def test_the_recording_holds_what_others_received(session: Session) -> None:
    recorded = {message.sequence: _twist(message.data) for message in session.topics["/cmd_vel"]}
    heard = {number: (linear, angular) for number, _, linear, angular in session.heard["commands"]}
    assert len(heard) > 100
    assert heard == {number: recorded[number] for number in heard}
    assert max(heard) == max(recorded)


def test_the_last_command_is_zero(session: Session) -> None:
    assert _twist(session.topics["/cmd_vel"][-1].data) == (0.0, 0.0)
    assert any(_twist(message.data)[0] > 0.1 for message in session.topics["/cmd_vel"])


def test_every_command_and_odometry_of_the_journal_is_recorded(session: Session) -> None:
    named = [entry.name for entry in session.journal]
    assert named.count("PublishTwist") + _zeros(session) == len(session.topics["/cmd_vel"])
    # At the end of the daemon, the last odometry may have reached only one of the two.
    assert 0 <= len(session.topics["/odom"]) - named.count("OdomReceived") <= 1


def _zeros(session: Session) -> int:
    """Return how many zeros the watchdog sent while a busy machine stalled the loop."""
    stalls = [json.loads(each.data) for each in session.journal if each.name == "LoopStalled"]
    return sum(each["zeros"] for each in stalls)


def test_the_status_topic_shows_each_change_of_mode(session: Session) -> None:
    statuses = session.topics["/robot_status"]
    shown = [deserialize_message(message.data, RobotStatus).mode for message in statuses]
    changes = [new for old, new in pairwise(shown) if new != old]
    decided = [
        json.loads(entry.data)["mode"] for entry in session.journal if entry.name == "ModeChanged"
    ]
    assert changes == decided


def test_the_counts_add_up(session: Session) -> None:
    recorder = session.before_stop["recorder"]
    assert recorder["received"] == recorder["written"] + recorder["queued"] + recorder["dropped"]
    assert (recorder["dropped"], recorder["lost"]) == (0, 0)
    assert set(session.topics) == {topic["name"] for topic in session.before_stop["topics"]}
    total = sum(len(messages) for messages in session.topics.values())
    assert f"recorded {total} messages" in session.log
    assert "0 dropped, 0 lost" in session.log


def test_a_fresh_kernel_decides_the_same_bit_for_bit(session: Session) -> None:
    assert session.journal[0].kind is EntryKind.SNAPSHOT
    assert sum(entry.kind is EntryKind.EFFECT for entry in session.journal) > 200
    assert first_divergence(session.journal) is None


def test_each_request_has_one_reply(session: Session) -> None:
    numbered = [each for each in session.journal if '"request_id"' in each.data]
    asked, replies = (
        [json.loads(each.data)["request_id"] for each in numbered if each.name.endswith(name)]
        for name in ("Requested", "Reply")
    )
    assert sorted(replies) == sorted(asked)
    assert len(set(asked)) == len(asked)


def test_nothing_moves_outside_moving(session: Session) -> None:
    mode = 0
    for entry in session.journal:
        if entry.name == "ModeChanged":
            mode = json.loads(entry.data)["mode"]
        elif entry.name == "PublishTwist" and mode != 1:
            assert json.loads(entry.data)["twist"] == {"linear": 0.0, "angular": 0.0}


def test_stop_leaves_no_process(session: Session) -> None:
    assert [command for command in session.processes.values() if "robotctl.daemon" in command] == []
    assert session.stopped.startswith("Stopped: ")
    assert str(session.folder) in session.stopped


def test_the_log_has_each_change_of_mode_with_time_and_reason(session: Session) -> None:
    line = r"^\d{4}-\d\d-\d\d .* IDLE -> MOVING: requested by the ROS service /set_mode$"
    assert re.search(line, session.log, re.MULTILINE)


def _twist(data: bytes) -> tuple[float, float]:
    """Forward and turning velocity of a serialized geometry_msgs/Twist."""
    message = deserialize_message(data, Twist)
    return message.linear.x, message.angular.z


def test_status_has_the_stable_keys(session: Session) -> None:
    status = session.idle
    assert set(status) == Status.__required_keys__
    assert set(status["pose"]) == {"x", "y", "theta"}
    assert set(status["velocity"]) == {"linear", "angular"}
    ledger = ("bytes", "written", "queued", "dropped", "lost", "throttled", "unseen")
    assert {frozenset(topic) for topic in status["topics"]} == {
        frozenset({"name", "type", "count", "rate", *ledger})
    }
    counts = {"received", *ledger} - {"unseen"}
    assert set(status["recorder"]) == {"state", "file", *counts}


def test_the_status_topic_comes_each_second(session: Session) -> None:
    times = [message.log_time / 1e9 for message in session.topics["/robot_status"]]
    changes = sum(entry.name == "ModeChanged" for entry in session.journal)
    periodic = len(times) - changes
    assert periodic - 1 <= times[-1] - times[0] <= periodic + 1
