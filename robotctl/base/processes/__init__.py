"""The one way to start another process of robotctl; standard library only.

    python -P -m robotctl.MODULE ARGUMENTS --report-fd 3

The child sends reports, one JSON object per line, through a separate pipe. It may also receive
lines on its stdin. Reports do not use stdout, because libraries print there (Fast DDS warns about
lock files); stdout and stderr go where a user reads them.

Each name is loaded on first use, so that a child that only reports and `robotctl stop` load little.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.base.processes.child import Child, program, start
    from robotctl.base.processes.pipes import (
        REPORT_OPTION,
        LineSplitter,
        pidfd_of,
        readable_within,
        report_fd,
        send_report,
    )

__all__ = [
    "REPORT_OPTION",
    "Child",
    "LineSplitter",
    "pidfd_of",
    "program",
    "readable_within",
    "report_fd",
    "send_report",
    "start",
]

_MODULES = {
    "REPORT_OPTION": "pipes",
    "Child": "child",
    "LineSplitter": "pipes",
    "pidfd_of": "pipes",
    "program": "child",
    "readable_within": "pipes",
    "report_fd": "pipes",
    "send_report": "pipes",
    "start": "child",
}
"""The module that defines each name."""


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # here, as in `robotctl.kernel`

    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
