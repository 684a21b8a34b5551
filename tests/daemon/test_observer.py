"""An observer does not affect another stack; false announcements do not affect a daemon."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from robotctl.replay.replay_guard import daemons_in, running_daemons
from tests.support.lines import Told, line_of, peer_command
from tests.support.waiting import until
from tests.support.world import InProcess, NewPeer, Peer, World, new_world, read_back

COMMANDS = 200


REFUSED = ["set-mode moving", "estop", "reset", "drive square", "lease status", "sim fault slip"]
REFUSED += ["drive velocity 0.1 0 --for 1s"]


class Observed:
    """The observations of one run of an observer."""

    def __init__(self, world: World, peer: Peer) -> None:
        peer("be_a_robot")
        self.started = world.ok("start", "--observe", "--exclude", "/odom,type:sensor_msgs/*")
        peer("send", kind="Twist", topic="/cmd_vel", count=COMMANDS)
        peer("send", kind="Twist", topic="/cmd_vel", count=COMMANDS)
        until(lambda: _counts(world.status()).get("/cmd_vel", 0) == 2 * COMMANDS)
        until(lambda: _counts(world.status()).get("/odom", 0) > 10)
        told = _counts(world.status())["/diagnostics"]
        until(lambda: _counts(world.status())["/diagnostics"] > told)
        self.screen = world.ok("status")
        world.ok("mark", "seen")
        world.ok("record", "split")
        watching = world.spawn("watch")
        _, self.line = line_of(watching.stdout), line_of(watching.stdout)
        self.status = world.status()
        self.nodes = peer("nodes")
        self.publishers = peer("publishers")
        self.services = peer("services")
        self.refusals = [world.here(*command.split()) for command in REFUSED]
        self.still = world.status()
        world.ok("stop")
        watching.communicate(timeout=30)
        self.topics = read_back(world.recording)


@pytest.fixture(scope="module")
def observed() -> Iterator[Observed]:
    with new_world() as world, Peer(world) as peer:
        yield Observed(world, peer)


def _counts(status: Any) -> dict[str, int]:
    return {topic["name"]: topic["count"] for topic in status["topics"]}


def test_it_publishes_no_command_serves_no_mode_and_simulates_nothing(observed: Observed) -> None:
    assert observed.nodes == ["/_recorder"]
    of_any_node = {"/rosout", "/parameter_events"}
    assert set(observed.publishers) == {"/diagnostics", "/robotctl/marks", *of_any_node}
    assert observed.services == []


def test_it_records_a_foreign_stack_with_its_commands(observed: Observed) -> None:
    assert len(observed.topics["/cmd_vel"]) == 2 * COMMANDS
    assert "/robotctl/journal" not in observed.topics


def test_it_takes_marks_and_splits_its_recording(observed: Observed) -> None:
    (message,) = observed.topics["/robotctl/marks"]
    assert b"seen [robotctl mark" in message.data
    assert observed.status["recorder"]["file"].endswith("_1.mcap")


def test_its_ledger_is_on_diagnostics(observed: Observed) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.serialization import deserialize_message

    last = deserialize_message(observed.topics["/diagnostics"][-1].data, DiagnosticArray)
    status, daemon = last.status
    assert (status.name, status.hardware_id) == ("robot: recorder", "robot")
    assert (status.level, status.message) == (b"\0", "everything is recorded")
    values = {entry.key: entry.value for entry in status.values}
    assert int(values["received"]) >= 2 * COMMANDS
    assert values["dropped"] == values["lost"] == "0"
    assert (daemon.name, daemon.hardware_id) == ("robot: daemon", "robot")
    assert (daemon.level, daemon.message, daemon.values) == (b"\0", "no warnings", [])


def test_what_people_read_says_that_it_observes(observed: Observed) -> None:
    assert "mode        observing (only records)" in observed.started
    assert "simulator" not in observed.started
    assert observed.screen.startswith("robot: observing")
    assert "pose" not in observed.screen
    assert "None" not in observed.screen
    assert "observing" in observed.line
    assert "None" not in observed.line


def test_what_moves_or_stops_a_robot_is_refused_with_a_sentence(observed: Observed) -> None:
    for ran in observed.refusals:
        assert ran.exit_code == 4, ran
        assert ran.err == (
            "robotctl: robot 'robot' is only observed (robotctl start --observe): "
            "nothing was sent to it; use the stop of the stack that drives it\n"
        )
    assert observed.still["mode"] is None


def test_a_publisher_that_restarts_is_no_loss(observed: Observed) -> None:
    sequences = [message.sequence for message in observed.topics["/cmd_vel"]]
    assert sequences == 2 * list(range(1, COMMANDS + 1))
    assert observed.status["recorder"]["lost"] == 0


async def test_it_is_in_no_replays_way(in_process: InProcess, world: World) -> None:
    async with in_process(observe=True, sim=None):
        (daemon,) = await asyncio.to_thread(running_daemons)
        assert (daemon.domain_id, daemon.observes) == (world.domain_id, True)
        assert await asyncio.to_thread(daemons_in, world.domain_id) == []
    async with in_process():
        (daemon,) = await asyncio.to_thread(daemons_in, world.domain_id)
        assert (daemon.mode, daemon.observes) == ("IDLE", False)


@pytest.mark.slow
def test_a_message_too_large_for_the_queue_is_named(world: World, new_peer: NewPeer) -> None:
    peer = new_peer(world)
    world.ok("start", "--observe")
    peer("send_large", topic="/large", size=200_000_000)
    until(lambda: _counts(world.status()).get("/large") == 1)
    peer("send", kind="Twist", topic="/cmd_vel", count=COMMANDS)
    until(lambda: _counts(world.status()).get("/cmd_vel") == COMMANDS)
    status = world.status()
    assert status["recorder"]["state"] == "recording"
    assert (status["recorder"]["dropped"], status["recorder"]["lost"]) == (1, 0)
    assert any("1 messages are not recorded, most of /large" in text for text in status["warnings"])
    world.ok("stop")
    topics = read_back(world.recording)
    assert (len(topics["/cmd_vel"]), len(topics["/large"])) == (COMMANDS, 0)


@pytest.mark.parametrize("option", [("--drive", "square"), ("--sim",)])
def test_an_observer_that_is_to_drive_is_not_started(world: World, option: tuple[str, ...]) -> None:
    world.here("start", "--observe", *option).failed(2, "--observe records and does nothing else")
    assert not world.recordings.exists()


STRANGE = [
    ("/types/main", "lib2to3/__main__/X"),
    ("/types/browser", "antigravity/x/X"),
    ("/types/module", "os.path/msg/X"),
    ("/types/own", "robot_controller/__main__/X"),
    ("/types/bytes", "std_msgs/msg/\xff\x1b[31m"),
    ("/my-topic", "std_msgs/msg/String"),
    ("/bad\xff\x1b[31m", "std_msgs/msg/String"),
]


@pytest.fixture(scope="module")
def simulated() -> Iterator[World]:
    """A world with one daemon, which simulates its robot."""
    with new_world() as made:
        made.ok("start", "--sim")
        yield made
        made.ok("stop")
        assert "Traceback" not in made.log()
        assert "\x1b" not in made.log()


@pytest.fixture
def hostile(simulated: World) -> Iterator[Told]:
    """A process that announces invalid data."""
    with Told(peer_command("tests.support.hostile_peer"), simulated.environment) as told:
        yield told


def test_the_daemon_drives_on_and_names_what_it_leaves_out(simulated: World, hostile: Told) -> None:
    simulated.ok("drive", "square")
    for topic, type_name in STRANGE:
        hostile("offer", topic=topic, type_name=type_name)
    until(lambda: sum("is not recorded" in text for text in simulated.status()["warnings"]) == 7)
    hostile("rename", name="\xff\x1b[31m", namespace="/\xfe")
    status = simulated.status()
    assert status["mode"] == "MOVING"
    assert all(text.isprintable() for text in status["warnings"])
    shown = simulated.ok("status")
    assert "\x1b" not in shown
    assert "/my-topic is not recorded: ROS does not allow its name" in " ".join(shown.split())
    simulated.ok("set-mode", "idle")


def test_each_publisher_of_commands_is_named_even_with_a_strange_name(
    simulated: World, hostile: Told
) -> None:
    hostile("offer", topic="/cmd_vel", type_name="std_msgs/msg/\xff")

    name = r"/\xfe/\xff\x1b[31m"

    def is_named() -> bool:
        hostile("rename", name="\xff\x1b[31m", namespace="/\xfe")
        return any(name in text for text in simulated.status()["warnings"])

    until(is_named)
    simulated.robotctl("set-mode", "moving").failed(4, name)
    assert simulated.status()["mode"] == "IDLE"
