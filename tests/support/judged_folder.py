"""Judges the recordings of a folder as `robotctl gate` does, without another process."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from robotctl.fleet.baseline import Baseline
from robotctl.fleet.gate import GateReport, judge_all
from robotctl.fleet.jobs import local_threads
from robotctl.fleet.judging import judge_here
from robotctl.fleet.result_store import ResultStore
from robotctl.recording.keep.listing import recordings_in
from robotctl.testing.drives import Written
from tests.support.checked_drives import altered

RESULTS = ".gate"

here = partial(judge_here, processes=local_threads)
"""The engine of a gate in this process."""


def judged(
    folder: Path,
    baseline: Baseline | None = None,
    settings: Mapping[str, str] | None = None,
) -> GateReport:
    """Judge all recordings of a folder; results are kept there."""
    store = ResultStore(folder / RESULTS)
    return judge_all(recordings_in(folder), store, settings or {}, baseline or Baseline(), here)


def wrong(written: list[Written], to: str = "0.0") -> list[Written]:
    """Return a drive with another last command: the kernel decides differently from there on."""
    return altered(written, "PublishTwist", '"linear":0.', f'"linear":{to}')[0]
