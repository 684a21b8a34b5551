"""The status as one row of a table, for output without a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robotctl.cli.terminal.status_screen import is_observer
from robotctl.cli.terminal.text import number, printable
from robotctl.ipc.answers import Status

_ROW = "{:>8} {:<14} {:>8} {:>8} {:>7} {:>7} {:>7} {:>8} {:>5}"
HEADER = _ROW.format(
    "up [s]", "mode", "x [m]", "y [m]", "theta", "v [m/s]", "battery", "written", "lost"
)


def status_line(status: Status) -> str:
    """Return mode, pose, speed, battery and recorder in the columns of HEADER; `-` is unknown."""
    pose: Mapping[str, Any] = status["pose"] or {}
    velocity: Mapping[str, Any] = status["velocity"] or {}
    recorder = status["recorder"]
    cells = (
        _cell(status.get("uptime_s"), ".1f"),
        "observing" if is_observer(status) else printable(status.get("mode")),
        *(_cell(pose.get(key), ".3f") for key in ("x", "y", "theta")),
        _cell(velocity.get("linear"), ".3f"),
        _cell(status.get("battery"), ".0%"),
        _cell(recorder.get("written"), "d"),
        _cell(recorder.get("lost"), "d"),
    )
    return _ROW.format(*cells)


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else number(value, form)
