"""A hash over all that is wrong with a recording, by which it is accepted."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from robotctl.fleet.change import Change
from robotctl.rerun.check_report import Report, rounded

_OTHER_RULES = re.compile(r"decided by the rules of another version \([^)]*\): ")


def outcome_of(
    path: Path | None,
    verdict: str,
    says: str,
    settings: Mapping[str, str],
    report: Report | None,
    other: Change | None,
) -> str:
    """Return the SHA-256 over a verdict, all that the check has found, and what settings change.

    Where the recording lies and which version finds the same make no difference.
    """
    found = None if report is None else report.divergence
    parts = {
        "verdict": verdict,
        "says": _OTHER_RULES.sub("", says) if found is None else "",
        "settings": dict(settings),
        "divergence": None
        if found is None
        else [found.seq, found.event, found.recorded, found.decided, *found.differences],
        "divergences": None if report is None else [report.divergences, report.divergences_crc],
        "violations": [] if report is None else [each.text for each in report.violations],
        "violation_count": 0 if report is None else report.violation_count,
        "missing": [] if report is None else _missing(report),
        "other": None if other is None else asdict(other),
    }
    text = json.dumps(parts, sort_keys=True)
    if path is not None:
        text = text.replace(json.dumps(str(path))[1:-1], path.name)
    return hashlib.sha256(rounded(text).encode()).hexdigest()


def _missing(report: Report) -> list[str]:
    """Return what could not be checked; for another version the report counts a divergence, too."""
    found = "" if report.divergence is None else report.divergence.sentence()
    sentences = [_OTHER_RULES.sub("", each) for each in report.missing]
    return [each for each in sentences if each != found]
