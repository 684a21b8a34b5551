"""Edits that pretend another version, another recorder, or another configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from random import Random

from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, edit
from tests.support.heard_drives import COMMANDS, JOURNAL
from tests.tampering.edits import MOTION, Kind, all_changed, journal, metadata, removed, rewritten
from tests.tampering.end_kinds import appended

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


def _first_received(contents: Contents, random: Random) -> Contents:
    return edit(
        contents,
        JOURNAL,
        lambda at, each: each if at else replace(each, publish_ns=each.publish_ns - 1000),
    )


OBSERVED = together(
    metadata("robotctl", "mode", "observing"),
    all_changed(JOURNAL, lambda each: replace(each, publish_ns=each.publish_ns - 1000)),
)
"""Pretend that the recorder received the journal."""

UNNAMED = together(
    *(
        metadata("robotctl", key, None)
        for key in ("topic.robot_status", "service.set_mode", "service.estop")
    )
)
"""Remove the names of topics and services, which an observer does not note."""

_DRIVEN_ON = appended(
    COMMANDS, (500, 500), lambda each: replace(each, data=MOTION), every_s=0.02, after_s=0.02
)


def excluding(pattern: str) -> Kind:
    """Pretend that the configuration leaves topics out."""
    return metadata("robotctl", "parameter.recording.exclude", f"[{pattern!r}]")


PRETENDED: Mapping[str, Kind] = {
    "journal: the proofs of all snapshots set to null": journal(
        rewritten("Snapshot", _PROOF, '"proof":null', everywhere=True)
    ),
    "journal: the proof of one snapshot set to null, chained anew": journal(
        rewritten("Snapshot", _PROOF, '"proof":null'), careful=True
    ),
    "metadata: a version to come, all proofs removed": without_proofs("9.9.9"),
    "metadata: no version, all proofs removed": without_proofs(""),
    "metadata: the robot renamed": metadata("robotctl", "robot", "other"),
    "metadata: the robot renamed, motion added for 10 s": together(
        metadata("robotctl", "robot", "other"), _DRIVEN_ON
    ),
    "metadata: the robot renamed, its journal received": together(
        metadata("robotctl", "robot", "other"),
        UNNAMED,
        OBSERVED,
        metadata("robotctl", "mode", "IDLE"),
    ),
    "metadata: the cameras left out, odometry removed": together(
        excluding("/camera/*"), removed(ODOMETRY)
    ),
    "metadata: the cameras left out, battery removed": together(
        excluding("/camera/*"), removed(BATTERY)
    ),
    "metadata: odometry left out, which is always recorded, and removed": together(
        excluding("/odom"), removed(ODOMETRY)
    ),
}
"""Edits that a check finds."""

FORGED_NAMES: Mapping[str, Kind] = {
    "metadata: version 0.1.0, all proofs removed": without_proofs("0.1.0"),
    "metadata: only observed, the journal received, motion added for 10 s": together(
        OBSERVED, _DRIVEN_ON
    ),
    "metadata: only observed, the first entry received": together(
        UNNAMED, metadata("robotctl", "mode", "observing"), _first_received
    ),
}
"""Edits that only the seal shows."""
