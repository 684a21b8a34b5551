"""Every edit of a sealed recording is found by its seal, also one that looks honest without it.

The forger edits consistently, hashes the chain again, and lacks only the private key.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from random import Random
from shutil import rmtree

import pytest

from robotctl.recording.format.seal_records import Opening
from robotctl.recording.read.whole_recording import RecordingProof, verify_recording
from robotctl.recording.write import mcap_writer
from tests.support.edited_recordings import Contents, write_contents
from tests.support.recordings import Forger, keyring
from tests.tampering.kinds import ACCEPTED, FORGED, recording_for
from tests.tampering.test_tampering import edits

ATTEMPTS = 60
MANY = 10_000


@pytest.fixture(autouse=True)
def _a_link_at_each_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_writer, "LINK_PERIOD_S", 0.0)


@pytest.fixture
def forger(tmp_path: Path, honest: dict[str, Contents]) -> Forger:
    return Forger(opening_of(tmp_path, honest["stopped"]))


def opening_of(tmp_path: Path, contents: Contents) -> Opening:
    """Seal a recording with the robot's key; return the opening of its seal."""
    found = verify_recording(
        write_contents(tmp_path / "sealed" / "run", contents, keyring(tmp_path / "keys"))
    )
    assert (found.proof, found.wrong) == (RecordingProof.SEALED, ())
    opening = found.files[0].seal.opening
    assert opening is not None
    return opening


def is_found(tmp_path: Path, edited: Contents, forger: Forger) -> bool:
    """Return whether the seal is broken, and tells between which bytes."""
    found = verify_recording(write_contents(tmp_path / "run", edited, forger))
    rmtree(tmp_path / "run")
    return found.proof is RecordingProof.BROKEN and any(
        "between byte" in each for each in found.wrong
    )


def missed(
    tmp_path: Path, honest: dict[str, Contents], forger: Forger, seed: int, count: int
) -> list[str]:
    """Return the edits that the seal does not show, of so many."""
    return [
        f"{name} ({recording}, {place})"
        for (name, _, recording, place), edited in islice(edits(honest, seed), count)
        if not is_found(tmp_path, edited, forger)
    ]


def test_edits_of_a_sealed_recording_are_found(
    tmp_path: Path, honest: dict[str, Contents], forger: Forger
) -> None:
    assert missed(tmp_path, honest, forger, 1, ATTEMPTS) == []


@pytest.mark.slow
def test_thousands_of_edits_of_a_sealed_recording_are_found(
    tmp_path: Path, honest: dict[str, Contents], forger: Forger
) -> None:
    assert missed(tmp_path, honest, forger, 2, MANY) == []


@pytest.mark.parametrize("name", [*ACCEPTED, *FORGED])
def test_what_a_check_does_not_show_is_found_by_the_seal(
    tmp_path: Path, honest: dict[str, Contents], forger: Forger, name: str
) -> None:
    kind = FORGED[name] if name in FORGED else ACCEPTED[name][0]
    recording = recording_for(name)
    assert is_found(tmp_path, kind(honest[recording], Random(1)), forger)
