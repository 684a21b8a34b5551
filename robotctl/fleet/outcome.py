"""A hash over all that is wrong with a recording, by which it is accepted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from robotctl import __version__
from robotctl.fleet.change import Change
from robotctl.rerun.check_report import Report
from robotctl.rerun.rounded import rounded


def outcome_of(
    path: Path | None,
    verdict: str,
    says: str,
    settings: Mapping[str, str],
    report: Report | None,
    other: Change | None,
) -> str:
    """Return the SHA-256 over a verdict, all that the check has found, and what settings change.

    Where the recording lies and which version this is make no difference.
    """
    found = None if report is None else report.divergence
    parts = {
        "verdict": verdict,
        "says": says,
        "settings": dict(settings),
        "divergence": None
        if found is None
        else [found.seq, found.event, found.recorded, found.decided, *found.differences],
        "divergences": None if report is None else [report.divergences, report.divergences_crc],
        "violations": [] if report is None else [each.text for each in report.violations],
        "violation_count": 0 if report is None else report.violation_count,
        "missing": [] if report is None else report.missing,
        "other": None if other is None else asdict(other),
    }
    text = json.dumps(parts, sort_keys=True).replace(f"this is {__version__}", "")
    if path is not None:
        text = text.replace(json.dumps(str(path))[1:-1], path.name)
    return hashlib.sha256(rounded(text).encode()).hexdigest()
