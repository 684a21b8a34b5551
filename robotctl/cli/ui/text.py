"""Text for a terminal, without control sequences from files or daemons."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any

from robotctl.base.text import printable as printable

COLUMNS = 80

UNLIMITED = 1 << 20
"""The width without a terminal [columns]."""

_YEAR_10000_S = 253_402_300_800
"""The end of the year 9999, in seconds since the epoch."""


def json_text(value: object) -> str:
    """Return the value as one line of JSON, in ASCII and without control characters."""
    return json.dumps(value)


def elided(text: object, width: int) -> str:
    """Return `text` in at most `width` columns, with `..` in place of its middle."""
    line = printable(text)
    if len(line) <= width:
        return line
    head = (width - 2) // 2  # names differ least in the middle
    return f"{line[:head]}..{line[len(line) - (width - 2 - head) :]}"


def row(label: str, text: object) -> Iterator[str]:
    """Yield a label with its text, wrapped into a column after the label."""
    line, width = printable(text), columns() - len(label)
    if len(line) <= width:
        yield f"{label}{line}"
        return
    from textwrap import wrap

    lines = wrap(line, max(width, 1), break_on_hyphens=False) or [""]
    yield f"{label}{lines[0]}"
    yield from (f"{'':{len(label)}}{line}" for line in lines[1:])


def short_path(path: object) -> str:
    """Return a path, relative to the working directory if it is below."""
    text = str(path)
    if "://" in text:
        return printable(text)
    try:
        relative = os.path.relpath(text)
    except (OSError, ValueError):
        return printable(text)
    return printable(text if relative.startswith("..") else relative)


def columns() -> int:
    """Return the maximum line width: at most 80 columns on a terminal, else UNLIMITED."""
    wide = _terminal_columns()
    return UNLIMITED if wide is None else min(wide or COLUMNS, COLUMNS)


def terminal_lines() -> int:
    """Return the number of lines of the terminal, UNLIMITED if it is unknown."""
    try:
        return os.get_terminal_size(sys.stdout.fileno()).lines or UNLIMITED
    except (OSError, ValueError):
        return UNLIMITED


def _terminal_columns() -> int | None:
    """Return the columns of the terminal, 0 if they are unknown, None without a terminal."""
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns
    except (OSError, ValueError):
        return None


def column_width(texts: Iterable[object], *, at_least: int, at_most: int) -> int:
    """Return the width of the longest text, but at least `at_least` and at most `at_most`."""
    longest = max((len(printable(text)) for text in texts), default=0)
    return min(max(longest, at_least), at_most)


def is_terminal() -> bool:
    """Return whether stdout is a terminal that can be drawn on."""
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def can_show_braille() -> bool:
    """Return whether stdout has an encoding with braille characters."""
    return "utf" in (sys.stdout.encoding or "").lower()


def size(count: float) -> str:
    """Return a number of bytes as text for people, in decimal units such as MB."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def duration(seconds: float) -> str:
    """Return a number of seconds as text for people."""
    whole = int(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def moment(time_ns: int) -> str:
    """Return `time_ns` (since the epoch) as local date and time; after the year 9999, in ns."""
    from robotctl.kernel.constants import NS_PER_S  # here, because `status` does not need it

    seconds = time_ns // NS_PER_S
    if seconds >= _YEAR_10000_S:  # a file may contain any number
        return f"{time_ns} ns"
    return time.strftime("%Y-%m-%d %H:%M:%S %z", time.localtime(seconds))


def number(value: Any, form: str) -> str:
    """Return `value` in the format `form`, or "unknown" if it is not a number."""
    return format(value, form) if isinstance(value, int | float) else "unknown"


def is_float(text: str) -> bool:
    """Return whether Python reads the text as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
