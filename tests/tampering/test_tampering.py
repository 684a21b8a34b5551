"""An edited recording is never called the same, however carefully it was edited."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from random import Random
from shutil import rmtree

import pytest

from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import COMMANDS
from tests.tampering.edits import Kind
from tests.tampering.kinds import (
    ACCEPTED,
    FORGED,
    FOUND,
    ON_A_BUTTON,
    ONLY_IF_CLOSED,
    recording_for,
)

ATTEMPTS = len(FOUND) + len(ON_A_BUTTON) + len(ONLY_IF_CLOSED)
"""Each kind is tried."""

MANY = 10_000

FLOOD = 30_000
"""In quadratic time it would take 20 s."""

CLOSED: tuple[str, ...] = ("stopped", "stalled", "pressed")
EVERY = (*CLOSED, "killed")


def checked(folder: Path, contents: Contents) -> Report:
    return check_recording(write_contents(folder / "run", contents))


@pytest.mark.parametrize("name", EVERY)
def test_an_honest_recording_is_the_same(
    tmp_path: Path, honest: dict[str, Contents], name: str
) -> None:
    report = checked(tmp_path, honest[name])
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


Plan = tuple[str, Kind, str, int]


def plans(seed: int) -> Iterator[Plan]:
    """Yield kind, edit, recording and seed of attempts: all kinds, one after the other."""
    random = Random(seed)
    every = [(name, kind, EVERY) for name, kind in FOUND.items()]
    every += [(name, kind, ("pressed",)) for name, kind in ON_A_BUTTON.items()]
    every += [(name, kind, CLOSED) for name, kind in ONLY_IF_CLOSED.items()]
    for name, kind, recordings in cycle(every):
        yield name, kind, random.choice(recordings), random.randrange(1 << 32)


def edits(honest: dict[str, Contents], seed: int) -> Iterator[tuple[Plan, Contents]]:
    """Yield attempts with the edited contents, where the recording has a place for the edit."""
    for plan in plans(seed):
        _, kind, recording, place = plan
        with suppress(IndexError):  # this recording has no such place
            edited = kind(honest[recording], Random(place))
            if edited != honest[recording]:
                yield plan, edited


def missed(tmp_path: Path, honest: dict[str, Contents], seed: int, count: int) -> list[str]:
    """Return the edits that a check calls the same, of so many."""
    same = []
    for (name, _, recording, place), edited in islice(edits(honest, seed), count):
        if checked(tmp_path, edited).verdict is Verdict.SAME:
            same.append(f"{name} ({recording}, {place})")
        rmtree(tmp_path / "run")
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
    recording = recording_for(name)
    report = checked(tmp_path, kind(honest[recording], Random(1)))
    assert report.verdict is Verdict.SAME


def test_the_page_tells_how_many_kinds_are_found() -> None:
    found, closed = len(FOUND) + len(ON_A_BUTTON), len(ONLY_IF_CLOSED)
    honest, forged = len(ACCEPTED), len(FORGED)
    page = " ".join((Path(__file__).parents[2] / "docs" / "replay.md").read_text().split())
    total = found + closed + honest + forged
    assert f"of {total} kinds, {found} are found in each recording and {closed} in one" in page
    assert f"{honest} look like an honest recording, each with its reason, and {forged} are" in page


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
    report = check_recording(path)
    assert time.process_time() - began < 5.0
    assert (report.verdict, report.commands) == (
        Verdict.BROKEN,
        FLOOD + honest["stopped"].counts[COMMANDS],
    )
