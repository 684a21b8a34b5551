"""Re-runs recorded decisions in a new kernel: check, what-if, closed-loop simulation, reasons.

Library users may rely on the names in `__all__`; the modules of this package may change:

- `check_recording` re-runs a recording, and reports what differs and which invariants it breaks;
  `check_recordings` does so for several, in several processes.
- `what_if` compares the recorded decisions with those of a kernel with other settings.
- `resimulate` repeats the recorded requests with a simulated robot, also with other settings.
- `find_incident` finds what stopped the robot, and `explain` says why in sentences.
- `first_divergence` re-runs journal entries that the caller has read.

Each name is loaded on first use.

    from pathlib import Path
    from robotctl.rerun import Verdict, check_recording

    assert check_recording(Path("recordings/run")).verdict is Verdict.SAME
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.rerun.check import check_recording
    from robotctl.rerun.check_many import check_recordings
    from robotctl.rerun.check_report import Divergence, Report, Verdict
    from robotctl.rerun.closed_loop import resimulate
    from robotctl.rerun.incident import Incident, IncidentKind, Searched, find_incident
    from robotctl.rerun.invariants import Violation
    from robotctl.rerun.recorded_settings import Settings, parse_settings
    from robotctl.rerun.rerun import first_divergence
    from robotctl.rerun.whatif import what_if
    from robotctl.rerun.why import Why, explain

__all__ = [
    "Divergence",
    "Incident",
    "IncidentKind",
    "Report",
    "Searched",
    "Settings",
    "Verdict",
    "Violation",
    "Why",
    "check_recording",
    "check_recordings",
    "explain",
    "find_incident",
    "first_divergence",
    "parse_settings",
    "resimulate",
    "what_if",
]

_MODULES = {
    "Divergence": "check_report",
    "Incident": "incident",
    "IncidentKind": "incident",
    "Report": "check_report",
    "Searched": "incident",
    "Settings": "recorded_settings",
    "Verdict": "check_report",
    "Violation": "invariants",
    "Why": "why",
    "check_recording": "check",
    "check_recordings": "check_many",
    "explain": "why",
    "find_incident": "incident",
    "first_divergence": "rerun",
    "parse_settings": "recorded_settings",
    "resimulate": "closed_loop",
    "what_if": "whatif",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
