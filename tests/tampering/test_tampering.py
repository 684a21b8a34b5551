"""An edited recording is never called the same, however carefully it was edited."""

from __future__ import annotations

from itertools import cycle, islice
from pathlib import Path
from random import Random

import pytest

from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from tests.support.edited_recordings import Contents, write_contents
from tests.tampering.edits import Kind
from tests.tampering.kinds import ACCEPTED, FOUND, ONLY_IF_CLOSED
from tests.tampering.sources import sources

ATTEMPTS = 200
MANY = 4_000

CLOSED: tuple[str, ...] = ("stopped", "stalled")
EVERY = (*CLOSED, "killed")


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Contents]:
    return sources(tmp_path_factory.mktemp("honest"))


def checked(folder: Path, contents: Contents) -> Report:
    return check_recording(write_contents(folder / "run", contents))


@pytest.mark.parametrize("name", EVERY)
def test_an_honest_recording_is_the_same(
    tmp_path: Path, honest: dict[str, Contents], name: str
) -> None:
    report = checked(tmp_path, honest[name])
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def plans(seed: int, count: int) -> list[tuple[str, Kind, str, int]]:
    """Return kind, edit, recording and seed of each attempt: all kinds, one after the other."""
    random = Random(seed)
    every = [(name, kind, EVERY) for name, kind in FOUND.items()]
    every += [(name, kind, CLOSED) for name, kind in ONLY_IF_CLOSED.items()]
    return [
        (name, kind, random.choice(recordings), random.randrange(1 << 32))
        for name, kind, recordings in islice(cycle(every), count)
    ]


def missed(tmp_path: Path, honest: dict[str, Contents], seed: int, count: int) -> list[str]:
    """Return the edits that a check calls the same."""
    same = []
    for number, (name, kind, recording, place) in enumerate(plans(seed, count)):
        try:
            edited = kind(honest[recording], Random(place))
        except IndexError:
            continue  # this recording has no such place
        if edited == honest[recording]:
            continue
        if checked(tmp_path / str(number), edited).verdict is Verdict.SAME:
            same.append(f"{name} ({recording}, {place})")
    return same


def test_edits_are_found(tmp_path: Path, honest: dict[str, Contents]) -> None:
    assert missed(tmp_path, honest, 1, ATTEMPTS) == []


@pytest.mark.slow
def test_thousands_of_edits_are_found(tmp_path: Path, honest: dict[str, Contents]) -> None:
    assert missed(tmp_path, honest, 2, MANY) == []


@pytest.mark.parametrize("name", ACCEPTED)
def test_what_looks_honest_is_listed(
    tmp_path: Path, honest: dict[str, Contents], name: str
) -> None:
    kind, reason = ACCEPTED[name]
    assert reason
    report = checked(tmp_path, kind(honest["stopped"], Random(1)))
    assert report.verdict is Verdict.SAME
