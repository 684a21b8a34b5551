"""A small map of the path driven over the wanted one, and the last speeds and errors."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from math import isfinite
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.text import Text

from robotctl.cli.terminal.text import number
from robotctl.ipc.answers import DrivenPath
from robotctl.show.figure import path_figure
from robotctl.show.terminal import ground_lines

_BARS: Final = " ▁▂▃▄▅▆▇█"

HISTORY: Final = 20
"""Values of a sparkline; at ten a second, those of the last 2 s."""

_OTHER_LINES: Final = 16
_MAP_ROWS: Final = range(5, 15)
"""How high the map may be; its width is twice that."""


class History:
    """The last speeds [m/s] and cross-track errors [m]."""

    def __init__(self) -> None:
        self.speeds: deque[float] = deque(maxlen=HISTORY)
        self.errors: deque[float] = deque(maxlen=HISTORY)

    def add(self, status: Mapping[str, Any]) -> None:
        """Keep the speed and the error of this status; without an error the earlier ones go."""
        self.speeds.append(_finite((status.get("velocity") or {}).get("linear")))
        error_m = (status.get("drive") or {}).get("cross_track_m")
        if error_m is None:
            self.errors.clear()
        else:
            self.errors.append(_finite(error_m))


def drive_map(path: DrivenPath, history: History, lines: int) -> RenderableType:
    """Return map and sparklines for a terminal of that many lines."""
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
    """Return a bar for each value by its amount; the highest of them is a full one."""
    amounts = [abs(value) for value in values]
    top = max(amounts, default=0.0)
    if not top:
        return _BARS[1] * len(amounts)
    return "".join(_BARS[1 + round(amount / top * (len(_BARS) - 2))] for amount in amounts)


def _finite(value: Any) -> float:
    return value if isinstance(value, float | int) and isfinite(value) else 0.0
