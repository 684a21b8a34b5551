"""Reports of a child: JSON objects, one per line, on a pipe of its own."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from typing import Any, Final

from robotctl.processes.descriptors import write_whole

REPORT_OPTION: Final = "--report-fd"

Report = Callable[[dict[str, Any]], None]
"""Sends a report of a job; raises BrokenPipeError if the process that started it has ended."""


class LineSplitter:
    """A splitter of a byte stream into lines; an incomplete line waits for the next piece."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """Return the lines that this piece completes."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        return whole


def report_fd(arguments: Sequence[str]) -> int:
    """Return, in a child, the descriptor for reports; call it after any restart of the process.

    Raises:
        SystemExit: The process was not started by robotctl.
    """
    *_, option, text = ("", "", *arguments)
    if option != REPORT_OPTION or not text.isdecimal():
        raise SystemExit(f"this is started by robotctl, with {REPORT_OPTION}")
    os.set_inheritable(int(text), False)
    return int(text)


def send_report(descriptor: int, report: dict[str, Any]) -> None:
    """Send a report to the process that started this one.

    Raises:
        BrokenPipeError: That process has closed the pipe.
    """
    write_whole(descriptor, f"{json.dumps(report)}\n".encode())


def decoded(line: bytes) -> dict[str, Any]:
    """Return the report of a line.

    Raises:
        ValueError: The line is not a JSON object.
    """
    report = json.loads(line)
    if not isinstance(report, dict):
        raise ValueError(f"not a JSON object: {line[:80]!r}")
    return report
