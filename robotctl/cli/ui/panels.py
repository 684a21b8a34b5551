"""The live views, drawn by rich: a daemon's status, its drive, and a recorded robot."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from robotctl.cli.ui.status import battery_text, is_observer, mode_text, pose_text, velocity_text
from robotctl.cli.ui.text import can_show_braille, columns, duration, number, printable, size
from robotctl.ipc.answers import DrivenPath, RecorderAnswer, Status, TopicAnswer
from robotctl.show.figure import path_figure
from robotctl.show.terminal import ground_lines

if TYPE_CHECKING:
    from robotctl.replay.recorded_robot import RecordedRobot

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
"""Maximum number of topics without a map and with a map, for a view of 24 lines."""


def live_view(status: Status, beside: RenderableType | None = None) -> RenderableType:
    """Return mode, pose, speed, battery, recorder and topics in one panel.

    `beside` is drawn to the left of the topics; fewer topics are then shown.
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


_BARS: Final = " ▁▂▃▄▅▆▇█"

HISTORY: Final = 20
"""The number of values in a sparkline."""

_OTHER_LINES: Final = 16
_MAP_ROWS: Final = range(5, 15)
"""Limits on the height of the map [lines]."""


class History:
    """The last HISTORY speeds [m/s] and cross-track errors [m] of the robot."""

    def __init__(self) -> None:
        self.speeds: deque[float] = deque(maxlen=HISTORY)
        self.errors: deque[float] = deque(maxlen=HISTORY)

    def add(self, status: Mapping[str, Any]) -> None:
        """Add speed and cross-track error of `status`; without an error, clear `errors`."""
        self.speeds.append(_finite((status.get("velocity") or {}).get("linear")))
        error_m = (status.get("drive") or {}).get("cross_track_m")
        if error_m is None:
            self.errors.clear()
        else:
            self.errors.append(_finite(error_m))


def drive_map(path: DrivenPath, history: History, lines: int) -> RenderableType:
    """Return the map of `path` and sparklines of `history` for a terminal of `lines` lines."""
    rows = min(max(lines - _OTHER_LINES, _MAP_ROWS.start), _MAP_ROWS.stop)
    figure = path_figure(path["reference"], path["driven"])
    picture = ground_lines(figure, rows=rows) if path["driven"] else []
    traces = (("speed", history.speeds, "m/s"), ("error", history.errors, "m"))
    shown = [
        f"{name} {sparkline(values):{HISTORY}} {number(values[-1], '.3f')} {unit}"
        for name, values, unit in traces
        if values
    ]
    return Group(*(Text(line, no_wrap=True, overflow="crop") for line in (*picture, *shown)))


def sparkline(values: Iterable[float]) -> str:
    """Return a bar for the absolute value of each number; the largest gets a full bar."""
    amounts = [abs(value) for value in values]
    top = max(amounts, default=0.0)
    if not top:
        return _BARS[1] * len(amounts)
    return "".join(_BARS[1 + round(amount / top * (len(_BARS) - 2))] for amount in amounts)


def _finite(value: Any) -> float:
    return value if isinstance(value, float | int) and isfinite(value) else 0.0


_PATH_ROWS = 12
"""The height of the path [lines]: view and progress bar then fit in a terminal of 24 lines."""


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
