"""Edits that pretend another version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from random import Random

from tests.support.edited_recordings import Contents
from tests.tampering.edits import Kind, journal, metadata, rewritten

_PROOF = r'"proof":\{[^}]*\}'


def together(*kinds: Kind) -> Kind:
    """Edit one after the other."""

    def make(contents: Contents, random: Random) -> Contents:
        for kind in kinds:
            contents = kind(contents, random)
        return contents

    return make


def without_proofs(version: str) -> Kind:
    """Remove the proofs from all snapshots, as if a version had made them that wrote none."""

    def named(contents: Contents, random: Random) -> Contents:
        return replace(
            metadata("robotctl", "robotctl", version)(contents, random),
            library=f"robotctl {version}",
        )

    removed = journal(rewritten("Snapshot", f",{_PROOF}", "", everywhere=True))
    return together(removed, named)


PRETENDED: Mapping[str, Kind] = {
    "journal: the proofs of all snapshots set to null": journal(
        rewritten("Snapshot", _PROOF, '"proof":null', everywhere=True)
    ),
    "journal: the proof of one snapshot set to null, chained anew": journal(
        rewritten("Snapshot", _PROOF, '"proof":null'), careful=True
    ),
    "metadata: version 0.1.0, all proofs removed": without_proofs("0.1.0"),
    "metadata: a version to come, all proofs removed": without_proofs("9.9.9"),
    "metadata: no version, all proofs removed": without_proofs(""),
}
"""Edits that a check finds."""
