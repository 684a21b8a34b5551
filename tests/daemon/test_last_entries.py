"""A clean stop records all messages and journal entries, and delivers the last zero."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.recording import recordings_folder
from robotctl.recording import Recorder, RecorderStats
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher
from tests.support.world import Peer, World, journal_of, read_back

SLOW_DISK_S = 0.3
"""How long the close of a recording takes here; meanwhile the peer sends 15 samples."""

Closed = list[RecorderStats]


@pytest.fixture
def closed(monkeypatch: pytest.MonkeyPatch) -> Closed:
    """The stats of each recorder, some time after its close."""
    said: Closed = []

    class ClosedSlowly(Recorder):
        def close(self) -> RecorderStats:
            super().close()
            time.sleep(SLOW_DISK_S)
            said.append(self.stats())
            return said[-1]

    monkeypatch.setattr(recordings_folder, "Recorder", ClosedSlowly)
    return said


@pytest.mark.parametrize("observe", [False, True])
async def test_nothing_is_received_any_more_when_the_recording_is_finished(
    in_process: Callable[..., Any],
    world: World,
    new_peer: Callable[[World], Peer],
    closed: Closed,
    observe: bool,
) -> None:
    peer = new_peer(world)
    peer("be_a_robot")
    peer("take_commands", kind="Twist")
    async with in_process(observe=observe, sim=None if observe else False) as daemon:
        await daemon.until(lambda status: count(status, "/odom") > 20)
    assert [(stats.dropped, stats.queued) for stats in closed] == [(0, 0)]


def count(status: Any, topic: str) -> int:
    return sum(each["count"] for each in status["topics"] if each["name"] == topic)


async def test_a_file_that_is_full_at_the_end_is_followed_by_none(
    in_process: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: Closed = []

    class FullAtEnd(Recorder):
        def __init__(self, *given: Any, on_full: Callable[[Path], None], **options: Any) -> None:
            super().__init__(*given, on_full=on_full, **options)
            self.tell_full = on_full

        def close(self) -> RecorderStats:
            """Report a full file at the close; the loop gets the call after it."""
            stats = super().close()
            self.tell_full(stats.file)
            time.sleep(SLOW_DISK_S)
            said.append(self.stats())
            return stats

    monkeypatch.setattr(recordings_folder, "Recorder", FullAtEnd)
    async with in_process():
        pass
    assert [stats.dropped for stats in said] == [0]


async def test_the_publisher_stays_until_the_last_zero_is_acknowledged(
    in_process: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[int] = []

    def acknowledged(velocity: VelocityPublisher) -> bool:
        published.append(velocity.published)
        return len(published) > 3

    monkeypatch.setattr(VelocityPublisher, "is_acknowledged", acknowledged)
    async with in_process():
        pass
    assert len(published) == 4
    assert len(set(published)) == 1, "a command was sent after it"


@pytest.mark.slow
def test_a_hundred_clean_stops_lose_no_entry(world: World) -> None:
    for _ in range(100):
        world.ok("start", "--sim", "--config", str(world.patient))
        world.ok("stop")
        assert ", 0 dropped, 0 lost" in world.log()
    for folder in world.recordings.iterdir():
        journal = journal_of(read_back(folder)["/robotctl/journal"])
        assert [entry.seq for entry in journal] == list(range(len(journal)))
