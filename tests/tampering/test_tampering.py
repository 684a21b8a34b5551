"""An edited recording is never called the same; the seal shows what looks honest without it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from random import Random
from shutil import rmtree

import pytest

from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.recording.read.whole_recording import RecordingProof, verify_recording
from robotctl.recording.write import mcap_writer
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import COMMANDS
from tests.support.recordings import Forger, keyring
from tests.tampering.edits import Kind
from tests.tampering.kinds import ACCEPTED, FOUND, ON_A_BUTTON, ONLY_IF_CLOSED, recording_for

ATTEMPTS = len(FOUND) + len(ON_A_BUTTON) + len(ONLY_IF_CLOSED)
"""Each kind is tried."""

MANY = 10_000

FLOOD = 30_000
"""In quadratic time it would take 20 s."""

CLOSED: tuple[str, ...] = ("stopped", "stalled", "pressed")
EVERY = (*CLOSED, "killed")

Plan = tuple[str, Kind, str, int]
Honest = dict[str, Contents]
IsFound = Callable[[Contents], bool]


@pytest.mark.parametrize("name", EVERY)
def test_an_honest_recording_is_the_same(tmp_path: Path, honest: Honest, name: str) -> None:
    report = check_recording(write_contents(tmp_path / "run", honest[name]))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def plans(seed: int) -> Iterator[Plan]:
    """Yield kind, edit, recording and seed of attempts: all kinds, one after the other."""
    random = Random(seed)
    every = [(name, kind, EVERY) for name, kind in FOUND.items()]
    every += [(name, kind, ("pressed",)) for name, kind in ON_A_BUTTON.items()]
    every += [(name, kind, CLOSED) for name, kind in ONLY_IF_CLOSED.items()]
    for name, kind, recordings in cycle(every):
        yield name, kind, random.choice(recordings), random.randrange(1 << 32)


def edits(honest: Honest, seed: int) -> Iterator[tuple[Plan, Contents]]:
    """Yield attempts with the edited contents, where the recording has a place for the edit."""
    for plan in plans(seed):
        _, kind, recording, place = plan
        with suppress(IndexError):  # this recording has no such place
            edited = kind(honest[recording], Random(place))
            if edited != honest[recording]:
                yield plan, edited


def missed(honest: Honest, is_found: IsFound, seed: int, count: int) -> list[str]:
    """Return the edits that are not found, of so many."""
    return [
        f"{name} ({recording}, {place})"
        for (name, _, recording, place), edited in islice(edits(honest, seed), count)
        if not is_found(edited)
    ]


@pytest.fixture
def by_check(tmp_path: Path) -> IsFound:
    """Return whether a check finds an edit."""

    def is_found(edited: Contents) -> bool:
        verdict = check_recording(write_contents(tmp_path / "run", edited)).verdict
        rmtree(tmp_path / "run")
        return verdict is not Verdict.SAME

    return is_found


@pytest.fixture
def by_seal(tmp_path: Path, honest: Honest, monkeypatch: pytest.MonkeyPatch) -> IsFound:
    """Return whether the seal is broken by an edit, and tells between which bytes.

    The forger edits consistently, hashes the chain again, and lacks only the private key.
    """
    monkeypatch.setattr(mcap_writer, "LINK_PERIOD_S", 0.0)  # a link at each commit
    sealed = write_contents(tmp_path / "sealed" / "run", honest["stopped"], keyring(tmp_path / "k"))
    found = verify_recording(sealed)
    assert (found.proof, found.wrong) == (RecordingProof.SEALED, ())
    opening = found.files[0].seal.opening
    assert opening is not None
    forger = Forger(opening)

    def is_found(edited: Contents) -> bool:
        found = verify_recording(write_contents(tmp_path / "run", edited, forger))
        rmtree(tmp_path / "run")
        return found.proof is RecordingProof.BROKEN and any(
            "between byte" in each for each in found.wrong
        )

    return is_found


def test_edits_are_found(honest: Honest, by_check: IsFound) -> None:
    assert missed(honest, by_check, 1, ATTEMPTS) == []


@pytest.mark.slow
def test_thousands_of_edits_are_found(honest: Honest, by_check: IsFound) -> None:
    assert missed(honest, by_check, 2, MANY) == []


def test_edits_of_a_sealed_recording_are_found(honest: Honest, by_seal: IsFound) -> None:
    assert missed(honest, by_seal, 1, 20) == []


@pytest.mark.slow
def test_thousands_of_edits_of_a_sealed_recording_are_found(
    honest: Honest, by_seal: IsFound
) -> None:
    assert missed(honest, by_seal, 2, MANY) == []


@pytest.mark.parametrize("name", ACCEPTED)
def test_what_looks_honest_is_shown_by_the_seal_alone(
    honest: Honest, by_check: IsFound, by_seal: IsFound, name: str
) -> None:
    kind, reason = ACCEPTED[name]
    edited = kind(honest[recording_for(name)], Random(1))
    assert reason
    assert not by_check(edited)
    assert by_seal(edited)


def test_the_page_tells_how_many_kinds_are_found() -> None:
    found, closed = len(FOUND) + len(ON_A_BUTTON), len(ONLY_IF_CLOSED)
    page = " ".join((Path(__file__).parents[2] / "docs" / "replay.md").read_text().split())
    total = found + closed + len(ACCEPTED)
    assert f"of {total} kinds, {found} are found in each recording and {closed} in one" in page
    assert f"{len(ACCEPTED)} look like an honest recording, each with its reason" in page


def test_a_flood_of_commands_of_decisions_that_never_come_takes_time_in_proportion(
    tmp_path: Path, honest: Honest
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
