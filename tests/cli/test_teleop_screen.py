"""The screen of `robotctl teleop`: the instructions are seen whole on any terminal."""

from __future__ import annotations

import io
from typing import Any, cast

import pytest
from rich.console import Console
from rich.live import Live

from robotctl.cli.commands.teleop.command import KEYS, WITH_RELEASES, WITHOUT_RELEASES, view_below
from robotctl.ipc.answers import Status

REFUSED = (
    "a refusal that says in more than one line of the terminal why the robot does not move: " * 2
)
TOPICS = [{"name": f"/topic{n}", "count": n, "rate": 1.0} for n in range(9)]
STATUS: dict[str, Any] = {
    "robot": "robot",
    "mode": "IDLE",
    "pose": None,
    "velocity": None,
    "battery": None,
    "recorder": {"state": "recording", "bytes": 1, "written": 1, "dropped": 0, "lost": 0},
    "topics": TOPICS,
    "warnings": ["the disk is nearly full"] * 2,
}


@pytest.mark.parametrize("instructions", [WITH_RELEASES, WITHOUT_RELEASES])
@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (80, 20), (80, 16), (80, 12), (40, 14)])
def test_the_instructions_and_refusals_are_seen_whole(
    columns: int, rows: int, instructions: tuple[str, ...]
) -> None:
    console = Console(width=columns, height=rows, file=io.StringIO(), force_terminal=True)
    lines = [*instructions, KEYS, "speed 0.30 m/s", REFUSED]
    with Live(console=console, auto_refresh=False) as live, console.capture() as drawn:
        live.update(view_below(lines, cast("Status", STATUS)), refresh=True)
    seen = " ".join(drawn.get().split())
    for line in lines:
        assert " ".join(line.split()) in seen
    assert max(map(len, instructions)) <= 80


def test_the_status_is_seen_on_a_usual_terminal() -> None:
    console = Console(width=80, height=24, file=io.StringIO())
    lines = [*WITHOUT_RELEASES, KEYS, "speed 0.30 m/s"]
    with console.capture() as drawn:
        console.print(view_below(lines, cast("Status", STATUS)))
    assert len(drawn.get().splitlines()) <= 23
    assert "/topic5" in drawn.get()
