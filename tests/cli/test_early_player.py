"""The process that plays starts before the option parser does, and ends where it is not needed."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.cli.support import early_process
from robotctl.cli.support.early_player import PLAYER, early_player
from robotctl.cli.support.early_process import early_or_new


class Child:
    """A process that is never started."""

    def __init__(self) -> None:
        self.killed = False

    def kill(self) -> None:
        self.killed = True

    def close(self, _: float) -> None:
        assert self.killed


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> list[Child]:
    made: list[Child] = []

    def begin(*_: object, **__: object) -> Child:
        made.append(Child())
        return made[-1]

    monkeypatch.setattr(early_process, "start", begin)
    monkeypatch.setattr(early_process, "fork", begin)
    return made


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("replay last", 1),
        ("replay run.mcap --rate max --json", 1),
        ("replay run.mcap --draw", 1),
        ("replay run.mcap --check", 0),
        ("replay run.mcap --what-if=tracking.k_y=8", 0),
        ("replay run.mcap --resim", 0),
        ("replay run.mcap --draw-only", 0),
        ("replay --help", 0),
        ("replay", 0),
    ],
)
def test_it_starts_early_where_the_line_plays_on_ros(
    started: list[Child], line: str, count: int
) -> None:
    with early_player(line.split()):
        assert len(started) == count


def test_it_is_killed_where_nothing_is_played(started: list[Child]) -> None:
    with early_player(["replay", "no-such-file"]):
        pass
    assert started[0].killed


def test_it_is_used_once(started: list[Child]) -> None:
    with early_player(["replay", "run.mcap"]):
        used: list[Any] = [early_or_new(PLAYER), early_or_new(PLAYER)]
        assert used == started
    assert not started[0].killed
