"""The recorded robot, drawn while its recording is played."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from robotctl.cli.terminal.status_panel import coloured_mode
from robotctl.cli.terminal.status_screen import pose_text, velocity_text
from robotctl.cli.terminal.text import can_show_braille, columns, number, printable
from robotctl.replay.recorded_robot import RecordedRobot
from robotctl.show.figure import path_figure
from robotctl.show.terminal import ground_lines

_PATH_ROWS = 12
"""Keeps the view and the bar within a terminal of 24 lines."""


def recorded_view(robot: RecordedRobot) -> RenderableType:
    """Return mode, pose, velocity and driven path of the recorded robot in one panel."""
    status = robot.status()
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="dim")
    facts.add_column()
    facts.add_row("mode", coloured_mode(status) if robot.mode else Text("unknown", style="dim"))
    facts.add_row("pose", Text(pose_text(status)))
    facts.add_row("velocity", Text(velocity_text(status)))
    parts: list[RenderableType] = [facts]
    if robot.path and can_show_braille():
        drawn = ground_lines(path_figure([], robot.path), rows=_PATH_ROWS)
        parts += [Text(), Text("\n".join(drawn), no_wrap=True)]
    return Panel(Group(*parts), title="recorded", title_align="left", width=columns())


def recorded_line(robot: RecordedRobot) -> str:
    """Return mode, pose and velocity of the recorded robot on one line."""
    status = robot.status()
    pose, velocity = status["pose"] or {}, status["velocity"] or {}
    fields = (
        str(robot.mode or "unknown"),
        *(f"{key} {number(pose.get(key), '.3f')}" for key in ("x", "y", "theta")),
        f"v {number(velocity.get('linear'), '.3f')}",
        f"w {number(velocity.get('angular'), '.3f')}",
    )
    return "  ".join(printable(field) for field in fields)
