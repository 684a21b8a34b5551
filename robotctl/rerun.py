"""Re-runs recorded decisions in a new kernel: check, what-if, closed-loop simulation, reasons.

Library users may rely on the names in `__all__`; the modules of `robotctl.check` may change:

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
    from robotctl.check.closed_loop import resimulate
    from robotctl.check.compare import first_divergence
    from robotctl.check.incident import Incident, IncidentKind, Searched, find_incident
    from robotctl.check.invariants import Violation
    from robotctl.check.report import Divergence, Report, Verdict
    from robotctl.check.run import check_recording, check_recordings
    from robotctl.check.what_if import Settings, parse_settings, what_if
    from robotctl.check.why import Why, explain

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
    "Divergence": "report",
    "Incident": "incident",
    "IncidentKind": "incident",
    "Report": "report",
    "Searched": "incident",
    "Settings": "what_if",
    "Verdict": "report",
    "Violation": "invariants",
    "Why": "why",
    "check_recording": "run",
    "check_recordings": "run",
    "explain": "why",
    "find_incident": "incident",
    "first_divergence": "compare",
    "parse_settings": "what_if",
    "resimulate": "closed_loop",
    "what_if": "what_if",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"robotctl.check.{_MODULES[name]}"), name)
