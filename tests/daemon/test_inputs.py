"""What comes in, as events of the kernel."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from robotctl.daemon import neighbours
from robotctl.daemon.inputs import Inputs
from robotctl.daemon.neighbours import watch_publishers
from robotctl.kernel.types import Cause, CommandPublishersSeen, Event, FaultCleared, FaultReported
from robotctl.testing.waiting import loop_until


class Velocity:
    """A command topic with the publishers that a test puts there; ours is one of them."""

    def __init__(self) -> None:
        self.others: tuple[str, ...] = ()
        self.calls: list[Any] = []
        self.looks = 0

    def count_publishers(self) -> int:
        self.looks += 1
        return 1 + len(self.others)

    def other_publishers(self) -> tuple[str, ...]:
        return self.others

    def open_gate(self) -> None:
        self.calls.append("gate opened")

    def dispatch(self, event: Event) -> None:
        self.calls.append(event)


def test_after_a_stall_the_kernel_stops_the_robot_before_commands_pass_again() -> None:
    velocity: Any = Velocity()
    motion: Any = None
    Inputs(velocity, motion, velocity).stalled("for 0.2 s")
    reported, cleared, gate = velocity.calls
    assert isinstance(reported, FaultReported)
    assert (reported.cause, reported.detail) == (Cause.LOOP_STALLED, "for 0.2 s")
    assert isinstance(cleared, FaultCleared)
    assert cleared.cause is Cause.LOOP_STALLED
    assert gate == "gate opened"


async def test_other_publishers_are_told_when_they_come_and_when_they_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(neighbours, "PUBLISHER_POLL_S", 0.0)
    velocity: Any = Velocity()
    watching = asyncio.create_task(watch_publishers(velocity, velocity.dispatch))

    async def seen(*names: str) -> list[tuple[str, ...]]:
        velocity.others = names
        looks = velocity.looks
        await loop_until(lambda: velocity.looks > looks + 3)
        assert all(isinstance(call, CommandPublishersSeen) for call in velocity.calls)
        return [call.names for call in velocity.calls]

    assert await seen() == []
    assert await seen("/a") == [("/a",)]
    assert await seen("/a", "/b") == [("/a",), ("/a", "/b")]
    assert await seen() == [("/a",), ("/a", "/b"), ()]
    watching.cancel()
