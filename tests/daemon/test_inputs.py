"""Input from ROS becomes events for the kernel."""

from __future__ import annotations

import asyncio
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
from tests.support.waiting import loop_until


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


async def test_other_publishers_are_events_when_they_appear_and_disappear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inputs, "PUBLISHER_POLL_S", 0.0)
    velocity: Any = Velocity()
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


async def test_a_change_of_the_command_subscribers_is_an_event(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inputs, "PUBLISHER_POLL_S", 0.0)
    velocity: Any = Velocity()
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


def test_our_own_commands_are_not_foreign() -> None:
    publishers = Publishers(moves=True)
    publishers.heard(b"ours")
    assert publishers.told == []


def test_the_first_command_of_another_publisher_is_enough() -> None:
    publishers = Publishers(moves=True)
    publishers.heard(b"theirs")
    assert publishers.told == ["/teleop"]


def test_a_publisher_that_is_already_gone_is_reported() -> None:
    publishers = Publishers(moves=True)
    publishers.heard(b"gone")
    assert publishers.told == [NAMELESS]


def test_a_flood_of_one_publisher_hides_no_other() -> None:
    publishers = Publishers(moves=False)
    for gid in (b"theirs", b"theirs", b"gone", b"theirs"):
        publishers.heard(gid)
    assert publishers.told == ["/teleop", NAMELESS]


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
