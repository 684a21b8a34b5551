"""One run of the daemon from start to stop, and its files; one promise in each test."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from robotctl.check.compare import first_divergence
from robotctl.ipc.answers import Status
from robotctl.recording import read_info
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.format.recorded_events import ERRORS
from tests.support.waiting import until
from tests.support.world import PATIENT, Peer, World, journal_of, new_world, read_back

AGILE = f"{PATIENT}limits: {{angular_rps: 4.0, angular_accel_rps2: 10.0}}\n"
"""A small circle takes 3 s."""


@dataclass(frozen=True, slots=True)
class Session:
    """The observations of one run of the daemon."""

    started: str
    idle: Any
    moving: Any
    drive: Any
    path: Any
    calls: dict[str, Any]
    late: list[int]
    malformed: list[Any]
    before_stop: Any
    stopped: str
    log: str
    heard: Any
    folder: Path
    topics: dict[str, list[Any]]
    processes: dict[int, str]

    @property
    def journal(self) -> list[JournalEntry]:
        """Every entry that was recorded."""
        return journal_of(self.topics["/robotctl/journal"])


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    """Run it once."""
    with new_world() as world:
        peer = Peer(world)
        try:
            yield _live(world, peer)
        finally:
            peer.close()


def _live(world: World, peer: Peer) -> Session:
    peer("listen")
    (world.folder / "agile.yaml").write_text(AGILE)
    started = world.ok("start", "--sim", "--config", "agile.yaml")
    until(lambda: peer("heard")["commands"])
    idle = world.status()
    calls = {"moving": peer("set_mode", mode=1)}
    until(lambda: world.status()["velocity"]["linear"] > 0.05)
    moving = world.status()
    calls["unknown"] = peer("set_mode", mode=7)
    calls["idle"] = peer("set_mode", mode=0)
    drive = world.answer(
        "drive", "circle", "--radius", "0.15", "--laps", "1", "--speed", "0.4", "--wait"
    )
    path = _ask(world, {"method": "path", "params": {}})
    assert Path(drive["picture"]).read_bytes().startswith(b"\x89PNG")
    calls["stop"] = peer("set_mode", mode=3)
    calls["refused"] = peer("set_mode", mode=1)
    late = peer("late_status")
    malformed = _malformed(world)
    world.ok("reset")
    before_stop = world.status()
    world.ok("set-mode", "moving")
    stopped = world.ok("stop")
    left = world.processes()
    folder = next(world.recordings.iterdir())
    topics = read_back(folder)
    last = topics["/cmd_vel"][-1].sequence
    until(lambda: peer("heard")["commands"][-1][0] == last)
    return Session(
        started=started,
        idle=idle,
        moving=moving,
        drive=drive,
        path=path,
        calls=calls,
        late=late,
        malformed=malformed,
        before_stop=before_stop,
        stopped=stopped,
        log=world.log(),
        heard=peer("heard"),
        folder=folder,
        topics=topics,
        processes=left,
    )


def _ask(world: World, *requests: dict[str, Any]) -> Any:
    """Return the answer to the last of these requests on one connection."""
    lines = [{"method": "hello", "params": {"protocol": 1}}, *requests]
    return _talk(
        world, *(json.dumps({"jsonrpc": "2.0", "id": i, **line}) for i, line in enumerate(lines))
    )[-1]


def _talk(world: World, *lines: str) -> list[Any]:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(world.folder / "run" / "robotctl" / "robot.sock"))
        client.sendall("".join(f"{line}\n" for line in lines).encode())
        with client.makefile() as answers:
            return [json.loads(answers.readline()) for _ in lines]


def _malformed(world: World) -> list[Any]:
    """Return the answers to invalid requests while another client waits for its answer."""
    return _talk(world, "{", '{"jsonrpc": "2.0", "id": 1, "method": "set_mode", "params": [NaN]}')


# Start and status


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


# The drive


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
    path = session.path["result"]
    for x, y in path["driven"]:
        nearest = min((x - a) ** 2 + (y - b) ** 2 for a, b in path["reference"])
        assert nearest < 0.05**2
    assert len(path["driven"]) > 50


# The ROS service, called from another process


def test_the_service_answers_as_the_command_line_does(session: Session) -> None:
    assert session.calls["moving"] == {
        "success": True,
        "message": "Mode changed to MOVING",
        "current_mode": 1,
    }
    assert session.calls["idle"] == {
        "success": True,
        "message": "Mode changed to IDLE",
        "current_mode": 0,
    }


def test_the_service_refuses_what_is_no_mode_and_stays(session: Session) -> None:
    answer = session.calls["unknown"]
    assert (answer["success"], answer["current_mode"]) == (False, 1)
    assert "0 IDLE, 1 MOVING, 2 ERROR, 3 EMERGENCY_STOP" in answer["message"]


def test_the_service_names_why_an_emergency_stop_holds(session: Session) -> None:
    answer = session.calls["refused"]
    assert (answer["success"], answer["current_mode"]) == (False, 3)
    assert "robotctl reset" in answer["message"]


def test_a_late_subscriber_learns_the_mode(session: Session) -> None:
    mode, number = session.late
    assert mode == 3
    assert number <= session.topics["/robot_status"][-1].sequence


# The socket


def test_nonsense_on_the_socket_is_answered_and_changes_nothing(session: Session) -> None:
    assert [answer["error"]["code"] for answer in session.malformed] == [-32700, -32700]
    assert session.before_stop["mode"] == "IDLE"


# The recording


@pytest.mark.parametrize("topic", ["/cmd_vel", "/odom", "/battery_state", "/robot_status"])
def test_every_message_is_recorded_from_the_first_to_the_last(session: Session, topic: str) -> None:
    sequence = [message.sequence for message in session.topics[topic]]
    assert sequence == list(range(1, len(sequence) + 1))


def test_every_call_of_the_service_is_recorded_with_its_answer(session: Session) -> None:
    from rclpy.serialization import deserialize_message

    from robotctl.ros.message_types import message_class

    kind = message_class("robot_controller/srv/SetMode_Event")
    events = [
        deserialize_message(message.data, kind)
        for message in session.topics["/set_mode/_service_event"]
    ]
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
    shown = [_mode(message.data) for message in session.topics["/robot_status"]]
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


# The journal


def test_a_fresh_kernel_decides_the_same_bit_for_bit(session: Session) -> None:
    journal = session.journal
    assert journal[0].kind is EntryKind.SNAPSHOT
    assert sum(entry.kind is EntryKind.EFFECT for entry in journal) > 200
    assert first_divergence(journal) is None


def test_each_request_has_one_reply(session: Session) -> None:
    asked = [
        json.loads(entry.data)["request_id"]
        for entry in session.journal
        if entry.kind is EntryKind.EVENT and entry.name.endswith("Requested")
    ]
    replies = [
        json.loads(entry.data)["request_id"] for entry in session.journal if entry.name == "Reply"
    ]
    assert sorted(replies) == sorted(asked)
    assert len(set(asked)) == len(asked)


def test_nothing_moves_outside_moving(session: Session) -> None:
    mode = 0
    for entry in session.journal:
        if entry.name == "ModeChanged":
            mode = json.loads(entry.data)["mode"]
        elif entry.name == "PublishTwist" and mode != 1:
            assert json.loads(entry.data)["twist"] == {"linear": 0.0, "angular": 0.0}


# The end


def test_stop_leaves_no_process(session: Session) -> None:
    assert [command for command in session.processes.values() if "robotctl.daemon" in command] == []
    assert session.stopped.startswith("Stopped: ")
    assert str(session.folder) in session.stopped


def test_the_log_has_each_change_of_mode_with_time_and_reason(session: Session) -> None:
    line = r"^\d{4}-\d\d-\d\d .* IDLE -> MOVING: requested by the ROS service /set_mode$"
    assert re.search(line, session.log, re.MULTILINE)


def _twist(data: bytes) -> tuple[float, float]:
    """Forward and turning velocity of a serialized geometry_msgs/Twist."""
    from geometry_msgs.msg import Twist
    from rclpy.serialization import deserialize_message

    message = deserialize_message(data, Twist)
    return message.linear.x, message.angular.z


def _mode(data: bytes) -> int:
    """The mode of a serialized robot_controller/RobotStatus."""
    from rclpy.serialization import deserialize_message
    from robot_controller.msg import RobotStatus

    return int(deserialize_message(data, RobotStatus).mode)


def test_status_has_the_stable_keys(session: Session) -> None:
    status = session.idle
    assert set(status) == Status.__required_keys__
    assert set(status["pose"]) == {"x", "y", "theta"}
    assert set(status["velocity"]) == {"linear", "angular"}
    ledger = ("bytes", "written", "queued", "dropped", "lost", "throttled", "unseen")
    assert {frozenset(topic) for topic in status["topics"]} == {
        frozenset({"name", "type", "count", "rate", *ledger})
    }
    assert set(status["recorder"]) == {
        "state",
        "file",
        "bytes",
        "received",
        "written",
        "queued",
        "dropped",
        "lost",
        "throttled",
    }


def test_the_status_topic_comes_each_second(session: Session) -> None:
    times = [message.log_time / 1e9 for message in session.topics["/robot_status"]]
    changes = sum(entry.name == "ModeChanged" for entry in session.journal)
    periodic = len(times) - changes
    assert periodic - 1 <= times[-1] - times[0] <= periodic + 1
