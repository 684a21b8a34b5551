"""On a disk that is almost full the heaviest topics are left out first, and never what proves."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.daemon.recording import disk_reserve
from robotctl.daemon.recording.disk_reserve import MAX_NAMED, DiskReserve
from tests.support.waiting import loop_until

GB = 10**9
SIZES = {"/odom": 9_000_000, "/camera": 5_000_000, "/scan": 1_000_000, "/idle": 0}


def gates(*topics: str) -> dict[str, list[Any]]:
    return {topic: [SimpleNamespace(is_shut=False)] for topic in topics}


def shut(reserve_gates: dict[str, list[Any]]) -> list[str]:
    return [topic for topic, (gate,) in reserve_gates.items() if gate.is_shut]


def grown(times: int) -> dict[str, int]:
    return {topic: times * size for topic, size in SIZES.items()}


def test_the_heaviest_is_left_out_first_and_further_ones_as_the_disk_fills() -> None:
    doors = gates("/camera", "/scan", "/idle")
    reserve = DiskReserve(10 * GB, doors)
    found = []
    for look, free_gb in enumerate([11.0, 9.9, 9.5, 8.9, 7.5, 3.0]):
        reserve.look(round(free_gb * GB), grown(look))
        found.append(list(reserve.stopped))
    camera, both = ["/camera"], ["/camera", "/scan"]
    assert found == [[], camera, camera, both, both, both]
    assert shut(doors) == both


def test_everything_is_recorded_again_when_there_is_room() -> None:
    doors = gates("/camera", "/scan")
    reserve = DiskReserve(10 * GB, doors)
    reserve.look(9 * GB, grown(1))
    assert shut(doors) == ["/camera"]
    reserve.look(round(10.5 * GB), grown(2))
    assert shut(doors) == ["/camera"]
    reserve.look(11 * GB, grown(3))
    assert (shut(doors), list(reserve.warnings())) == ([], [])


def test_each_topic_that_is_left_out_is_named_with_the_reason() -> None:
    reserve = DiskReserve(10 * GB, gates("/camera"))
    reserve.look(9_990_000_000, grown(1))
    (told,) = reserve.warnings()
    assert told == (
        "/camera is not recorded: the disk has 9.99 GB free, less than 10 GB "
        "(recording.min_free_gb; see robotctl recordings rm)"
    )


async def test_a_disk_that_cannot_be_asked_is_told_as_long_as_it_lasts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_reserve, "LOOK_S", 0.01)
    reserve = DiskReserve(10 * GB, gates("/camera"))
    recorder: Any = SimpleNamespace(stats=lambda: SimpleNamespace(topics=()))
    missing = tmp_path / "gone"
    looking = asyncio.create_task(reserve.run(recorder, missing))
    await loop_until(lambda: list(reserve.warnings()))
    assert list(reserve.warnings()) == [
        f"the free space of {missing} is not known: No such file or directory"
    ]
    missing.mkdir()
    await loop_until(lambda: not list(reserve.warnings()))
    looking.cancel()


async def test_without_a_reserve_nobody_looks(tmp_path: Path) -> None:
    recorder: Any = None
    await DiskReserve(0, {}).run(recorder, tmp_path)


def test_of_many_topics_some_are_named() -> None:
    names = [f"/t{number}" for number in range(MAX_NAMED + 5)]
    reserve = DiskReserve(10 * GB, gates(*names))
    for look in range(1, len(names) + 1):
        reserve.look(-look * GB, dict.fromkeys(names, look))
    assert len(list(reserve.warnings())) == MAX_NAMED + 1


@pytest.mark.parametrize("free", [0, 5 * GB])
def test_a_topic_without_messages_is_not_left_out(free: int) -> None:
    doors = gates("/idle")
    DiskReserve(10 * GB, doors).look(free, SIZES)
    assert shut(doors) == []
