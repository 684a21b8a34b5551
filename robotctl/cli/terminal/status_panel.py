"""The live view of a daemon, drawn by rich from the object of `status --json`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from robotctl.cli.terminal.status_screen import (
    battery_text,
    is_observer,
    mode_text,
    pose_text,
    velocity_text,
)
from robotctl.cli.terminal.text import columns, duration, number, printable, size
from robotctl.ipc.answers import RecorderAnswer, Status, TopicAnswer

_MODE_STYLES = {
    "IDLE": "bold cyan",
    "MOVING": "bold green",
    "ERROR": "bold red",
    "EMERGENCY_STOP": "bold white on red",
}
_MAX_TOPICS = 12
_BESIDE_WIDTH = 38
_NAME_WIDTH_BESIDE = 18
_MAX_TOPICS_BESIDE = 8
"""They keep the view within a terminal of 24 lines."""


def live_view(status: Status, beside: RenderableType | None = None) -> RenderableType:
    """Return mode, pose, speed, battery, recorder and topics in one panel.

    `beside` stands beside the topics, of which fewer are shown then.
    """
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="dim")
    facts.add_column()
    facts.add_row("mode", coloured_mode(status))
    if not is_observer(status):
        facts.add_row("pose", Text(pose_text(status)))
        facts.add_row("velocity", Text(velocity_text(status)))
        facts.add_row("battery", Text(battery_text(status)))
    facts.add_row("recorder", _recorder(status["recorder"]))
    for warning in status["warnings"]:
        facts.add_row("warning", Text(printable(warning), style="yellow"))
    title = Text(f"{printable(status.get('robot'))}  up {duration(status.get('uptime_s') or 0)}")
    if beside is None:
        below: RenderableType = _topics(status["topics"], _MAX_TOPICS)
    else:
        below = Table.grid(padding=(0, 2))
        below.add_column(width=_BESIDE_WIDTH)
        below.add_row(beside, _topics(status["topics"], _MAX_TOPICS_BESIDE, _NAME_WIDTH_BESIDE))
    body = Group(facts, Text(), below)
    return Panel(body, title=title, title_align="left", width=columns())


def coloured_mode(status: Mapping[str, Any]) -> Text:
    """Return the mode in its colour, with phase and reason."""
    mode = mode_text(status)
    text = Text(mode, style=_MODE_STYLES.get(mode, "bold"))
    if status.get("phase"):
        text.append(f"  {printable(status['phase'])}", style="default not bold")
    if status.get("mode_reason"):
        text.append(f"  {printable(status['mode_reason'])}", style="dim not bold")
    return text


def _recorder(recorder: RecorderAnswer) -> Text:
    text = Text(f"{printable(recorder.get('state'))}  {size(recorder.get('bytes') or 0)}  ")
    text.append(f"{recorder.get('written')} messages  ")
    for name in ("dropped", "lost"):
        text.append(f"{recorder.get(name)} {name}  ", style="red" if recorder.get(name) else "")
    return text


def _topics(topics: list[TopicAnswer], most: int, name_width: int | None = None) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("topic", no_wrap=True, overflow="ellipsis", max_width=name_width)
    table.add_column("count", justify="right")
    table.add_column("Hz", justify="right")
    for topic in topics[:most]:
        name, count = printable(topic.get("name")), str(topic.get("count"))
        table.add_row(Text(name), count, number(topic.get("rate"), ".1f"))
    if len(topics) > most:
        table.add_row(Text(f"and {len(topics) - most} more", style="dim"), "", "")
    return table
