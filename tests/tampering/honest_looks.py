"""Edits that look like an honest recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.heard_drives import COMMANDS, ESTOP, STATUS
from tests.tampering.edits import (
    MOTION,
    Kind,
    all_changed,
    anywhere,
    changed,
    counted,
    journal,
    metadata,
    removed,
    still,
)
from tests.tampering.end_kinds import appended, repeated_at_the_end
from tests.tampering.event_kinds import no_events
from tests.tampering.message_changes import last_number
from tests.tampering.pretended_kinds import OBSERVED, UNNAMED, together
from tests.tampering.schema_kinds import READ, commented, described
from tests.tampering.stretches import stretch_removed

ACCEPTED: Mapping[str, tuple[Kind, str]] = {
    "commands: some zeros added at the end, one in 50 ms": (
        appended(COMMANDS, (1, 20), still, every_s=0.05, after_s=0.05),
        "the watchdog sends them in a stall, and the journal tells of it afterwards",
    ),
    "commands: two zeros added at the end of a recording that was killed": (
        appended(COMMANDS, (2, 2), still),
        "a daemon that fails sends its last zeros without a decision",
    ),
    "odometry: some added at the end": (
        appended(ODOMETRY, (1, 10)),
        "they were under way when the recording ended",
    ),
    "battery: some added at the end": (
        appended(BATTERY, (1, 10)),
        "they were under way when the recording ended",
    ),
    "status: the last one repeated once": (
        repeated_at_the_end(STATUS, (1, 1), lambda message: message),
        "each file begins with the last status, and files may be put together",
    ),
    "commands: one 100 ms late": (
        changed(COMMANDS, lambda m, _: replace(m, publish_ns=m.publish_ns + 10**8), anywhere),
        "a busy machine may hold up a step for longer than that",
    ),
    "odometry: the last one dropped": (
        lambda contents, random: all_changed(
            ODOMETRY, lambda m: None if m.sequence == last_number(contents, ODOMETRY) else m
        )(contents, random),
        "what was under way at the end is not recorded",
    ),
    "journal: odometry dropped while standing, chained anew": (
        lambda contents, random: journal(
            lambda entries, _: [
                None if '"sequence":2,' in each.data and each.name == "OdomReceived" else each
                for each in entries
            ],
            careful=True,
        )(contents, random),
        "the control loop takes its inputs with best effort, and the CRCs were computed again",
    ),
    "journal: one of equal messages of the button dropped, chained anew": (
        lambda contents, random: journal(
            lambda entries, _: [
                None if each.name == "SafetyInputReceived" and '"sequence":5' in each.data else each
                for each in entries
            ],
            careful=True,
        )(contents, random),
        "of equal messages only some become events",
    ),
    "all topics: a stretch of standing removed, its ticks counted as missed": (
        stretch_removed(1.3, 1.6, missed=True),
        "a process that is suspended while the robot stands leaves the same",
    ),
    "metadata: another version": (
        metadata("robotctl", "robotctl", "9.9.9"),
        "a note tells the version that it claims; all decisions are compared",
    ),
    "ledger: a command more lost": (
        counted(COMMANDS, "lost", 1),
        "it is a loss that nothing contradicts",
    ),
    "status: topic and its name removed": (
        lambda contents, random: metadata("robotctl", "topic.robot_status", None)(
            removed(STATUS)(contents, random), random
        ),
        "recordings of before that do not tell the name, and nothing is decided on a status",
    ),
    "status: another temperature": (
        changed(STATUS, lambda m, _: replace(m, data=m.data[:-5] + MOTION[:4] + b"\1"), anywhere),
        "it is only measured to be shown",
    ),
    "service: another client": (
        all_changed(ESTOP, lambda m: replace(m, data=m.data.replace(b"\1" * 16, b"\2" * 16))),
        "no decision depends on which client called",
    ),
    "schema: a comment changed": (
        described(commented, *READ),
        "the fields are the same, and a comment changes no value",
    ),
    "metadata: only observed, the journal received, no names and events of its own": (
        together(OBSERVED, UNNAMED, no_events),
        "an observer receives the journal; a note tells what is not compared then",
    ),
    "metadata: the mode at the start changed": (
        metadata("robotctl", "mode", "MOVING"),
        "no decision depends on it: the journal holds the mode",
    ),
}
"""Edits that look like an honest recording, with the reason. A sealed recording shows them."""
