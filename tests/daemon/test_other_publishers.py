"""Other nodes that publish commands or odometry: heard, named, refused, let through."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Iterator
from typing import Any

import pytest

from robotctl.daemon.control import inputs
from robotctl.daemon.control.inputs import MAX_TOLD, NAMELESS, ForeignCommands, watch_graph
from robotctl.kernel.types import (
    CommandListenersSeen,
    CommandPublishersSeen,
    Event,
    ForeignCommandHeard,
)
from robotctl.recording import read_messages
from robotctl.recording.format.journal import decode
from tests.support.waiting import loop_until, until
from tests.support.world import PATIENT, NewPeer, World, world_with_daemon


class Velocity:
    """A command topic with publishers that a test sets; one publisher is ours."""

    def __init__(self) -> None:
        self.others: tuple[str, ...] = ()
        self.taking: tuple[int, tuple[str, ...]] = (1, ())
        self.calls: list[Event] = []
        self.looks = 0

    def other_publishers(self) -> tuple[str, ...]:
        self.looks += 1
        return self.others

    def count_listeners(self) -> int:
        return self.taking[0] + len(self.taking[1])

    def listeners(self) -> tuple[int, tuple[str, ...]]:
        return self.taking

    def find_names(self) -> None:
        pass

    def dispatch(self, event: Event) -> None:
        self.calls.append(event)


async def look_again(velocity: Velocity, times: int) -> None:
    """Wait until the publishers were counted again."""
    looks = velocity.looks
    await loop_until(lambda: velocity.looks > looks + times)


@pytest.fixture
def velocity(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(inputs, "PUBLISHER_POLL_S", 0.0)
    return Velocity()


async def test_other_publishers_are_events_when_they_appear_and_disappear(velocity: Any) -> None:
    watching = asyncio.create_task(watch_graph(velocity, velocity, velocity.dispatch))

    async def seen(*names: str) -> list[tuple[str, ...]]:
        velocity.others = names
        await look_again(velocity, 3)
        return [call.names for call in velocity.calls if isinstance(call, CommandPublishersSeen)]

    assert await seen() == []
    assert await seen("/a") == [("/a",)]
    assert await seen("/a", "/b") == [("/a",), ("/a", "/b")]
    assert await seen() == [("/a",), ("/a", "/b"), ()]
    watching.cancel()


async def test_a_change_of_the_command_subscribers_is_an_event(velocity: Any) -> None:
    watching = asyncio.create_task(watch_graph(velocity, velocity, velocity.dispatch))
    told: list[tuple[int, tuple[str, ...]]] = []
    for taking in ((0, ()), (1, ()), (0, ("x/msg/Other",)), (1, ("x/msg/Other",))):
        velocity.taking = taking
        told.append(taking)
        await look_again(velocity, 12)
        seen = [call for call in velocity.calls if isinstance(call, CommandListenersSeen)]
        assert [(each.count, each.other_types) for each in seen] == told
    watching.cancel()


class Publishers:
    """Node names by the gid of their publisher, and whether the robot moves."""

    def __init__(self, *, moves: bool) -> None:
        self.names = {b"theirs": "/teleop"}
        self.events: list[Event] = []
        self.heard = ForeignCommands(
            b"ours", lambda gid: self.names.get(gid, ""), lambda: moves, self.events.append
        ).heard

    @property
    def told(self) -> list[str]:
        assert all(isinstance(event, ForeignCommandHeard) for event in self.events)
        return [event.publisher for event in self.events]  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("moves", "gids", "told"),
    [
        (True, [b"ours"], []),
        (True, [b"theirs"], ["/teleop"]),
        (True, [b"gone"], [NAMELESS]),
        (False, [b"theirs", b"theirs", b"gone", b"theirs"], ["/teleop", NAMELESS]),
    ],
    ids=["our own", "the first is enough", "gone already", "a flood of one hides no other"],
)
def test_each_foreign_publisher_is_told(moves: bool, gids: list[bytes], told: list[str]) -> None:
    publishers = Publishers(moves=moves)
    for gid in gids:
        publishers.heard(gid)
    assert publishers.told == told


def test_a_flood_of_new_publishers_gives_few_events() -> None:
    publishers = Publishers(moves=False)
    for number in range(1000):
        publishers.heard(b"%d" % number)
    assert 0 < len(publishers.told) <= 5 * MAX_TOLD


def test_a_flood_to_an_idle_robot_gives_few_events() -> None:
    publishers = Publishers(moves=False)
    for _ in range(1000):
        publishers.heard(b"theirs")
    assert len(publishers.told) < 50


EntryData = dict[str, float]


@pytest.fixture(scope="module")
def simulated() -> Iterator[World]:
    """A world with one daemon, for which a publisher of odometry is gone after 2 s."""
    with world_with_daemon(settings=PATIENT.replace("timeout_s: 10.0", "timeout_s: 2.0")) as made:
        yield made


@pytest.fixture
def idle(simulated: World) -> World:
    """The world, when nothing of an earlier test keeps its robot from driving."""
    until(lambda: simulated.here("reset").exit_code == 0)
    until(lambda: simulated.here("preflight").exit_code == 0)
    return simulated


@pytest.fixture
def driving(idle: World) -> World:
    """The world, while its robot drives."""
    until(lambda: idle.here("drive", "circle", "--laps", "0").exit_code == 0)
    return idle


def events(world: World, name: str) -> list[EntryData]:
    """Return the journal entries with this name that are in the recording so far."""
    messages = read_messages(world.recording, {"/robotctl/journal"})
    entries = (decode(each.data) for each in messages)
    return [json.loads(entry.data) for entry in entries if entry.name == name]


def heard_since(world: World, begin_ns: int) -> bool:
    """Return whether a foreign command was heard after this time."""
    return any(each["t_ns"] >= begin_ns for each in events(world, "ForeignCommandHeard"))


def test_one_command_of_a_publisher_that_is_gone_at_once_stops_a_moving_robot(
    driving: World, new_peer: NewPeer
) -> None:
    sent_ns = new_peer(driving)("command_and_go", linear=0.1)
    until(lambda: driving.status()["mode"] == "ERROR")
    # The graph may show the publisher before its command comes.
    assert re.search("also publishe[sd] (a )?velocity command", driving.status()["mode_reason"])
    until(lambda: heard_since(driving, sent_ns))


def test_commands_of_best_effort_are_heard_as_well(driving: World, new_peer: NewPeer) -> None:
    begin_ns = time.monotonic_ns()
    new_peer(driving)("command_best_effort", linear=0.1)
    until(lambda: driving.status()["mode"] == "ERROR")
    assert "velocity command" in driving.status()["mode_reason"]
    until(lambda: heard_since(driving, begin_ns))


def test_the_publisher_of_commands_is_shown_and_refuses_motion_until_it_is_gone(
    driving: World, new_peer: NewPeer
) -> None:
    peer = new_peer(driving)
    peer("command", linear=0.1)
    until(lambda: driving.status()["mode"] == "ERROR")
    # Its command may be heard before the graph shows the publisher, or before it has a name.
    assert "also publish" in driving.status()["mode_reason"]
    warning = "/somebody_else also publishes velocity commands"
    until(lambda: warning in driving.status()["warnings"])
    for request in (("set-mode", "moving"), ("reset",)):
        driving.here(*request).failed(4, "stop the other publisher")
    peer.close()
    until(lambda: warning not in driving.status()["warnings"])


def test_a_second_publisher_of_odometry_refuses_every_start(idle: World, new_peer: NewPeer) -> None:
    peer = new_peer(idle)
    peer("measure", x=10.0)
    until(lambda: any("and /somebody_else" in each for each in idle.status()["warnings"]))
    assert idle.status()["mode"] == "IDLE"
    for request in (("drive", "square", "--wait"), ("set-mode", "moving")):
        idle.here(*request).failed(
            4, "odometry comes from two publishers, /simulated_robot and /somebody_else"
        )
    assert idle.status()["odometry_dropped"] > 0
    peer.close()
    until(lambda: idle.here("set-mode", "moving").exit_code == 0)
    idle.ok("set-mode", "idle")
    until(lambda: {1, 2} <= {each["source"] for each in events(idle, "OdometrySourceFound")})


def test_a_second_publisher_of_odometry_that_contradicts_stops_a_moving_robot(
    driving: World, new_peer: NewPeer
) -> None:
    new_peer(driving)("measure", x=10.0)
    until(lambda: driving.status()["mode"] == "ERROR")
    reason = driving.status()["mode_reason"]
    assert "odometry comes from two publishers, /simulated_robot and " in reason
    assert "m and " in reason


def test_one_command_to_an_idle_robot_is_named_and_no_error(idle: World, new_peer: NewPeer) -> None:
    sent_ns = new_peer(idle)("command_and_go", linear=0.1)
    until(lambda: heard_since(idle, sent_ns))
    until(lambda: any("velocity command" in each for each in idle.status()["warnings"]))
    assert idle.status()["mode"] == "IDLE"


SETTINGS = f"""{PATIENT}
command: {{when_idle: silent, foreign: yield}}
"""


def test_others_drive_in_idle_and_a_start_waits_until_they_are_quiet(world: World) -> None:
    world.ok("start", "--sim", settings=SETTINGS)
    with world.peer("MuxPeer") as joystick:
        joystick("want", topic="/cmd_vel", linear=0.2)
        until(lambda: world.status()["velocity"]["linear"] > 0.18)
        assert world.status()["mode"] == "IDLE"
        until(lambda: _refused_by_name(world))
        joystick("rest")
        until(lambda: world.here("set-mode", "moving").exit_code == 0)
        joystick("want", topic="/cmd_vel", linear=0.2)
        until(lambda: world.status()["mode"] == "ERROR")
        assert "planner" in world.status()["mode_reason"]
        joystick("rest")
        until(lambda: world.status()["velocity"]["linear"] < 0.01)
        until(lambda: world.here("reset").exit_code == 0)
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert report["verdict"] == "same"
    assert [text for text in report["notes"] if "published as well" not in text] == []


def _refused_by_name(world: World) -> bool:
    """Whether a start is refused with the name of the node, which may come after its commands."""
    refused = world.here("set-mode", "moving")
    assert refused.exit_code == 4, refused
    return "planner" in refused.err


GUARDED = f"""{PATIENT}
guard: true
guard_timeout_s: 2.0
command.lock_topic: robotctl/lock
"""
"""A timeout that a busy machine keeps."""


def test_a_planner_steers_in_moving_only_and_an_emergency_stop_locks_the_mux(world: World) -> None:
    world.ok("start", "--sim", settings=GUARDED)
    with world.peer("MuxPeer") as planner:
        planner("mux", lock="/robotctl/lock", wanted="/cmd_vel_nav")
        planner("want", topic="/cmd_vel_nav", linear=0.2)
        until(lambda: planner("state")["passed"])
        assert world.status()["velocity"]["linear"] < 0.01
        assert "guarding cmd_vel_nav" in world.ok("set-mode", "moving")
        until(lambda: world.status()["velocity"]["linear"] > 0.15)
        world.here("set-mode", "idle")
        world.ok("set-mode", "moving")
        until(lambda: world.status()["velocity"]["linear"] > 0.15)
        planner("rest")
        until(lambda: world.status()["velocity"]["linear"] < 0.01)
        assert world.status()["mode"] == "MOVING"
        world.ok("estop")
        until(lambda: planner("state")["locked"])
        world.ok("reset")
        until(lambda: planner("state")["locked"] is False)
    world.ok("stop")
    (report,) = world.answer("replay", "last", "--check")["recordings"]
    assert report["verdict"] == "same"
    # What others want while the robot is not guarded is recorded, and is no input.
    assert not [text for text in report["notes"] if "did not reach" in text]
