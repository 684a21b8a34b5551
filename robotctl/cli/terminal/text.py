"""Text for a terminal: nothing that comes from a file or a daemon may steer it."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any

from robotctl.kernel.units import NS_PER_S
from robotctl.printable import printable as printable

COLUMNS = 80

UNLIMITED = 1 << 20
"""In a pipe or a file: nothing is cut or wrapped, so that others can search and cut lines."""

_LAST_MOMENT_NS = 253_402_300_800 * NS_PER_S
"""The end of the year 9999."""


def json_text(value: object) -> str:
    """One line of JSON, in ASCII: no control character survives."""
    return json.dumps(value)


def elided(text: object, width: int) -> str:
    """`text` in at most `width` columns, cut in the middle, where names differ least."""
    line = printable(text)
    if len(line) <= width:
        return line
    head = (width - 2) // 2
    return f"{line[:head]}..{line[len(line) - (width - 2 - head) :]}"


def row(label: str, text: object) -> Iterator[str]:
    """Text beside its label, wrapped into a column of its own."""
    line, width = printable(text), columns() - len(label)
    if len(line) <= width:
        yield f"{label}{line}"
        return
    from textwrap import wrap

    lines = wrap(line, width, break_on_hyphens=False)
    yield f"{label}{lines[0]}"
    yield from (f"{'':{len(label)}}{line}" for line in lines[1:])


def short_path(path: object) -> str:
    """A path relative to the working directory where it lies below it."""
    text = str(path)
    try:
        relative = os.path.relpath(text)
    except (OSError, ValueError):
        return printable(text)
    return printable(text if relative.startswith("..") else relative)


def columns() -> int:
    """Return how wide a line may be: at most 80 columns on a terminal, UNLIMITED elsewhere."""
    wide = _terminal_columns()
    return UNLIMITED if wide is None else min(wide or COLUMNS, COLUMNS)


def _terminal_columns() -> int | None:
    """Return the columns of the terminal, 0 where it does not know them; None without one."""
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns
    except (OSError, ValueError):
        return None


def column_width(texts: Iterable[object], *, at_least: int, at_most: int) -> int:
    """Return how wide a column is that shows these texts, within the limits."""
    longest = max((len(printable(text)) for text in texts), default=0)
    return min(max(longest, at_least), at_most)


def is_terminal() -> bool:
    """Whether our output goes to a terminal that can be drawn on."""
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def size(count: float) -> str:
    """Bytes as people read them, in powers of ten."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def duration(seconds: float) -> str:
    """Seconds as people read them."""
    whole = int(seconds)
    if whole < 60:
        return f"{seconds:.1f} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def moment(time_ns: int) -> str:
    """A time since the epoch as a clock in this place shows it."""
    if time_ns > _LAST_MOMENT_NS:  # a file may claim anything
        return f"{time_ns} ns"
    seconds = time.localtime(time_ns // NS_PER_S)
    return time.strftime("%Y-%m-%d %H:%M:%S %z", seconds)


def number(value: Any, form: str) -> str:
    """A number in the given format, or `unknown` where there is none."""
    return format(value, form) if isinstance(value, int | float) else "unknown"
