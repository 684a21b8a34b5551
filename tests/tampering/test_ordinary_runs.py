"""A check finds the same in an edited recording, whether it compares runs of steps or each step.

And whether it reads every byte beside that, or afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from robotctl.rerun import check
from robotctl.rerun.agreed import Agreed
from robotctl.rerun.batch import Batch
from robotctl.rerun.check_report import Report, Verdict
from robotctl.rerun.journal_steps import Step
from robotctl.rerun.ordinary_run import OrdinaryRun, Single, ordinary_runs
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import COMMANDS
from tests.tampering.sources import sources
from tests.tampering.test_tampering import edits

ATTEMPTS = 40
MANY = 2_000

FLOOD = 30_000
"""In quadratic time it would take 20 s."""


class EachAlone:
    """Yields what is read one by one, each with the log times of what was read before it."""

    def __init__(self) -> None:
        self._log_times = (0, 0)

    def __call__(self, batch: Batch, agreed: Iterable[Agreed]) -> Iterator[Single]:
        """Yield the items of a batch, and its end."""
        following, times = iter(agreed), iter(batch.log_times)
        for item in batch.items:
            if isinstance(item, Step):
                self._log_times = next(times)
                yield item, self._log_times, next(following, None)
            else:
                yield item, self._log_times, None
        if batch.end is not None:
            self._log_times = batch.end_log_times
            yield batch.end, self._log_times, None


def reported(path: Path) -> Report:
    return replace(check.check_recording(path), took_s=0.0)


def shown(path: Path) -> str:
    return repr(reported(path))  # nan is not equal to nan


def differing(
    folder: Path,
    honest: dict[str, Contents],
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
    count: int,
) -> list[str]:
    """Return the edits of which the two ways tell different things."""
    found = []
    tried = islice(edits(honest, seed), count)
    for number, ((name, _, recording, place), edited) in enumerate(tried):
        path = write_contents(folder / str(number) / "run", edited)
        together = shown(path)
        with monkeypatch.context() as patched:
            patched.setattr(check, "ordinary_runs", EachAlone())
            patched.setattr(check, "bytes_beside", lambda *_, **__: None)
            alone = shown(path)
        if together != alone:
            found.append(f"{name} ({recording}, {place})")
    return found


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Contents]:
    return sources(tmp_path_factory.mktemp("honest"))


def test_almost_all_steps_of_an_honest_recording_are_ordinary(
    tmp_path: Path, honest: dict[str, Contents], monkeypatch: pytest.MonkeyPatch
) -> None:
    alone: list[Single] = []

    def noted(batch: Batch, agreed: list[Agreed]) -> Iterator[OrdinaryRun | Single]:
        for part in ordinary_runs(batch, agreed):
            if not isinstance(part, OrdinaryRun):
                alone.append(part)
            yield part

    monkeypatch.setattr(check, "ordinary_runs", noted)
    report = reported(write_contents(tmp_path / "run", honest["stopped"]))
    assert report.events > 300
    assert len(alone) < 30


def test_a_report_does_not_depend_on_how_much_is_compared_at_once(
    tmp_path: Path, honest: dict[str, Contents], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert differing(tmp_path, honest, monkeypatch, 3, ATTEMPTS) == []


@pytest.mark.slow
def test_thousands_of_reports_do_not_depend_on_how_much_is_compared_at_once(
    tmp_path: Path, honest: dict[str, Contents], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert differing(tmp_path, honest, monkeypatch, 4, MANY) == []


def test_a_flood_of_commands_of_decisions_that_never_come_takes_time_in_proportion(
    tmp_path: Path, honest: dict[str, Contents]
) -> None:
    edited = honest["stopped"].copy()
    at = [i for i, each in enumerate(edited.messages) if each.topic == COMMANDS][20]
    last = edited.messages[at]
    edited.messages[at + 1 : at + 1] = [
        replace(last, sequence=last.sequence + 5_000 + number) for number in range(FLOOD)
    ]
    path = write_contents(tmp_path / "run", edited)
    began = time.process_time()
    report = reported(path)
    assert time.process_time() - began < 5.0
    assert (report.verdict, report.commands) == (
        Verdict.BROKEN,
        FLOOD + honest["stopped"].counts[COMMANDS],
    )
