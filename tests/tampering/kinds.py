"""All kinds of edits, by what a check makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.heard_drives import COMMANDS, ESTOP, SET_MODE, STATUS
from tests.tampering.edits import (
    Kind,
    all_changed,
    anywhere,
    changed,
    counted,
    cut,
    cut_behind_snapshot,
    dropped,
    dropped_and_renumbered,
    journal,
    removed,
    renamed,
    repeated,
    rewritten,
    swapped,
    without,
)
from tests.tampering.end_kinds import AT_THE_END, BUTTON, THOUSANDS_OF_THE_BUTTON
from tests.tampering.event_kinds import FORGED_EVENTS
from tests.tampering.journal_changes import last_dropped
from tests.tampering.journal_kinds import IN_JOURNAL
from tests.tampering.message_changes import numbered
from tests.tampering.pretended_kinds import FORGED_NAMES, PRETENDED, excluding, together
from tests.tampering.schema_kinds import FORGED_SCHEMAS
from tests.tampering.time_kinds import FORGED_TIMES
from tests.tampering.topic_kinds import FORGED_STATUSES, IN_TOPICS

FOUND: Mapping[str, Kind] = {
    **IN_TOPICS,
    **IN_JOURNAL,
    **AT_THE_END,
    **PRETENDED,
}
"""Edits that a check finds: its verdict is not `same`."""

FORGED: Mapping[str, Kind] = {
    **FORGED_EVENTS,
    **FORGED_NAMES,
    **FORGED_SCHEMAS,
    **FORGED_STATUSES,
    **FORGED_TIMES,
}
"""Edits that no fault makes, only a forger of an unsealed file: the seal shows them."""

ON_A_BUTTON: Mapping[str, Kind] = {
    "button: thousands added at the end": THOUSANDS_OF_THE_BUTTON,
    "button: one pressed message released": changed(
        BUTTON, lambda m, _: replace(m, data=m.data[:4] + b"\0"), lambda m: m.data[4] == 1
    ),
    "button: one released message pressed": changed(
        BUTTON, lambda m, _: replace(m, data=m.data[:4] + b"\1"), lambda m: m.data[4] == 0
    ),
    "button: one dropped": dropped(BUTTON, 1, lambda each: 1 < each.sequence < 28),
    "button: one repeated": repeated(BUTTON),
    "button: one with another number": changed(BUTTON, numbered, anywhere),
    "button: one dropped, the others renumbered": dropped_and_renumbered(
        BUTTON, lambda each: each.sequence < 16
    ),
    "button: two swapped": swapped(BUTTON, anywhere),
    "button: all released": all_changed(BUTTON, lambda m: replace(m, data=m.data[:4] + b"\0")),
    "button: topic removed": removed(BUTTON),
    "metadata: the cameras left out, the button removed": together(
        excluding("/camera/*"), removed(BUTTON)
    ),
    "journal: a message of the button dropped": journal(without("SafetyInputReceived")),
    "journal: the press set to released, chained anew": journal(
        rewritten("SafetyInputReceived", r'"value":1\.0', '"value":0.0'), careful=True
    ),
    "journal: all presses set to released, chained anew": journal(
        rewritten("SafetyInputReceived", r'"value":1\.0', '"value":0.0', everywhere=True),
        careful=True,
    ),
    "journal: all messages of the button dropped, chained anew": journal(
        lambda entries, _: [
            None if each.name == "SafetyInputReceived" else each for each in entries
        ],
        careful=True,
    ),
}
"""Edits that a check finds in a recording with an emergency stop button."""

ONLY_IF_CLOSED: Mapping[str, Kind] = {
    "odometry: the first dropped": dropped(ODOMETRY, 1, lambda each: each.sequence == 1),
    "battery: the first dropped": dropped(BATTERY, 1, lambda each: each.sequence == 1),
    "journal: the last entries dropped": journal(last_dropped),
    "journal: the last entries dropped, chained anew": journal(last_dropped, careful=True),
    "commands: any dropped, the others renumbered": dropped_and_renumbered(COMMANDS),
    "journal: a tick dropped, chained anew": journal(without("Tick"), careful=True),
    "journal: a missed tick added": journal(rewritten("Tick", r'"missed":0', '"missed":1')),
    "the end cut off": cut(0.5),
    "the end cut off behind a snapshot": cut_behind_snapshot,
    "status: one dropped": dropped(STATUS),
    "status: all removed": all_changed(STATUS, lambda m: None),
    "service: all calls removed": all_changed(SET_MODE, lambda m: None),
    "service: topic removed": removed(ESTOP),
    "service: topic renamed": renamed(ESTOP),
    "metadata: the cameras left out, a service removed": together(
        excluding("/camera/*"), removed(ESTOP)
    ),
    "service: a response removed": all_changed(SET_MODE, lambda m: None if m.sequence == 2 else m),
    "ledger: a command more received": counted(COMMANDS, "received", 1),
    "ledger: a command more written": counted(COMMANDS, "written", 1),
}
"""Edits that are found in a recording that was closed. One that was killed ends anywhere, has no
ledger, and no snapshot after its last entries: an end cut off at a commit is what a kill leaves.
The first inputs may lack, because the recorder finds a publisher later than the control loop."""
