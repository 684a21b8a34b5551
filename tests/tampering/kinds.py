"""All kinds of edits, by what a check makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.testing.hearing import BATTERY, ODOMETRY, TOPICS
from tests.support.heard_drives import COMMANDS, ESTOP, JOURNAL, SET_MODE, STATUS, received
from tests.tampering import edits
from tests.tampering.edits import Kind

BUTTON = TOPICS[SafetyInput.ESTOP]
"""The topic of the emergency stop button."""

READ = (COMMANDS, ODOMETRY, BATTERY, STATUS, JOURNAL, SET_MODE, ESTOP)
"""The topics whose messages a check reads."""

_LIMITS = r'"linear_mps":[0-9.]+'

FOUND: Mapping[str, Kind] = {
    "schema: of another version, with its hash": edits.described(edits.of_another_version, *READ),
    "channel: no type hash": edits.described(
        lambda channel, schema: edits.with_type_hash(channel, schema, ""), *READ
    ),
    "channel: another encoding": edits.described(
        lambda channel, schema: (replace(channel, message_encoding="json"), schema),
        *(COMMANDS, ODOMETRY, BATTERY, STATUS),
    ),
    "commands: any dropped": edits.dropped(COMMANDS),
    "commands: one dropped, the others renumbered": edits.dropped_and_renumbered(
        COMMANDS, edits.moves
    ),
    "commands: one changed by an ulp": edits.changed(COMMANDS, edits.by_one_ulp, edits.moves),
    "commands: one that moves set to zero": edits.changed(
        COMMANDS, lambda m, _: edits.still(m), edits.moves
    ),
    "commands: one repeated": edits.repeated(COMMANDS),
    "commands: two swapped": edits.swapped(COMMANDS, edits.moves),
    "commands: one with another number": edits.changed(COMMANDS, edits.numbered, edits.moves),
    "commands: one sent late": edits.changed(COMMANDS, lambda m, _: edits.late(m), edits.anywhere),
    "commands: one sent early": edits.changed(
        COMMANDS, lambda m, _: edits.early(m), edits.anywhere
    ),
    "commands: all removed": edits.all_changed(COMMANDS, lambda m: None),
    "commands: topic removed": edits.removed(COMMANDS),
    "commands: topic renamed": edits.renamed(COMMANDS),
    "commands: motion added": edits.added(COMMANDS, edits.MOTION),
    "odometry: one dropped": edits.dropped(ODOMETRY, 1, edits.not_first),
    "odometry: those of the last second dropped": edits.last_second_dropped(ODOMETRY),
    "odometry: one dropped, the others renumbered": edits.dropped_and_renumbered(
        ODOMETRY, edits.not_last
    ),
    "odometry: one moved": edits.changed(ODOMETRY, edits.moved, edits.anywhere),
    "odometry: one repeated": edits.repeated(ODOMETRY),
    "odometry: one with another number": edits.changed(ODOMETRY, edits.numbered, edits.anywhere),
    "odometry: topic removed": edits.removed(ODOMETRY),
    "battery: one dropped": edits.dropped(BATTERY, 1, edits.not_first),
    "battery: one changed": edits.changed(BATTERY, edits.level, edits.anywhere),
    "battery: topic removed": edits.removed(BATTERY),
    "status: another mode": edits.changed(
        STATUS, lambda m, _: edits.with_mode(m, Mode.ERROR), lambda m: m.sequence == 2
    ),
    "status: another robot": edits.changed(STATUS, edits.robot, edits.anywhere),
    "status: topic removed": edits.removed(STATUS),
    "service: a call for another mode": edits.changed(
        SET_MODE, edits.flipped(edits.AT_REQUESTED), lambda m: m.sequence == 1
    ),
    "service: a response says the opposite": edits.changed(
        SET_MODE, edits.flipped(edits.AT_SUCCESS), lambda m: m.sequence == 2
    ),
    "service: a call received late": edits.changed(
        ESTOP, lambda m, _: edits.late(m), lambda m: m.sequence == 1
    ),
    "service: a call added": edits.added(ESTOP, received(9, None)),
    "commands: zeros with numbers beyond all decisions added at the end": edits.appended(
        COMMANDS, (1, 300), edits.still, first=5_000
    ),
    "commands: some zeros added at the end, at once": edits.appended(
        COMMANDS, (5, 20), edits.still
    ),
    "commands: zeros with one number added at the end": edits.appended(
        COMMANDS, (5, 60), edits.still, step=0
    ),
    "commands: motion added at the end": edits.appended(
        COMMANDS, (1, 100), lambda message: replace(message, data=edits.MOTION)
    ),
    "odometry: some added later": edits.appended(ODOMETRY, (1, 20), every_s=0.02, after_s=3.0),
    "status: the last one repeated at the end": edits.repeated_at_the_end(
        STATUS, (5, 60), lambda message: message
    ),
    "status: the last one repeated at the end, with another mode": edits.repeated_at_the_end(
        STATUS, (1, 1), lambda message: edits.with_mode(message, Mode.ERROR)
    ),
    "service: responses added at the end": edits.appended(ESTOP, (1, 300)),
    "service: some calls added later": edits.appended(
        ESTOP, (1, 20), edits.call, every_s=0.1, after_s=3.0
    ),
    "journal: an entry dropped": edits.dropped(JOURNAL),
    "journal: an entry repeated": edits.repeated(JOURNAL),
    "journal: two entries swapped": edits.journal(edits.two_swapped),
    "journal: an event one ns later": edits.journal(edits.later),
    "journal: an event of rare kind dropped, chained anew": edits.chained_anew(edits.rare_dropped),
    "journal: a tick dropped": edits.journal(edits.without("Tick")),
    "journal: odometry dropped": edits.journal(edits.without("OdomReceived")),
    "journal: an effect dropped, chained anew": edits.decided_without_event,
    "journal: odometry changed, chained anew": edits.chained_anew(
        edits.rewritten("OdomReceived", r'"x":([-0-9.e]+)', r'"x":1.5')
    ),
    "journal: a battery level changed, chained anew": edits.chained_anew(
        edits.rewritten("BatteryReceived", r'"level":[0-9.]+', '"level":0.77')
    ),
    "journal: a command changed, chained anew": edits.chained_anew(
        edits.rewritten("PublishTwist", r'"linear":0\.', '"linear":0.1')
    ),
    "journal: a reason changed, chained anew": edits.chained_anew(
        edits.rewritten("ModeChanged", r'"reason":"', '"reason":"not ')
    ),
    "journal: a limit changed in all snapshots, chained anew": edits.chained_anew(
        edits.rewritten("Snapshot", _LIMITS, '"linear_mps":0.59', everywhere=True)
    ),
    "journal: topic removed": edits.removed(JOURNAL),
    "metadata: the limit of the velocity changed": edits.metadata(
        "robotctl", "parameter.limits.linear_mps", "0.59"
    ),
    "metadata: the topic of the commands changed": edits.metadata(
        "robotctl", "parameter.command.topic", "other"
    ),
}
"""Edits that a check finds: its verdict is not `same`."""

ACCEPTED: Mapping[str, tuple[Kind, str]] = {
    "commands: some zeros added at the end, one in 50 ms": (
        edits.appended(COMMANDS, (1, 20), edits.still, every_s=0.05, after_s=0.05),
        "the watchdog sends them in a stall, and the journal tells of it afterwards",
    ),
    "commands: two zeros added at the end of a recording that was killed": (
        edits.appended(COMMANDS, (2, 2), edits.still),
        "a daemon that fails sends its last zeros without a decision",
    ),
    "odometry: some added at the end": (
        edits.appended(ODOMETRY, (1, 10)),
        "they were under way when the recording ended",
    ),
    "status: the last one repeated once": (
        edits.repeated_at_the_end(STATUS, (1, 1), lambda message: message),
        "each file begins with the last status, and files may be put together",
    ),
    "commands: one 100 ms late": (
        edits.changed(
            COMMANDS, lambda m, _: replace(m, publish_ns=m.publish_ns + 10**8), edits.anywhere
        ),
        "a busy machine may hold up a step for longer than that",
    ),
    "odometry: the last one dropped": (
        lambda contents, random: edits.all_changed(
            ODOMETRY, lambda m: None if m.sequence == edits.last_number(contents, ODOMETRY) else m
        )(contents, random),
        "what was under way at the end is not recorded",
    ),
    "journal: odometry dropped while standing, chained anew": (
        edits.entries_dropped(
            lambda each: each.name == "OdomReceived" and '"sequence":2,' in each.data
        ),
        "the control loop takes its inputs with best effort, and the CRCs were computed again",
    ),
    "journal: one of equal messages of the button dropped, chained anew": (
        edits.entries_dropped(
            lambda each: each.name == "SafetyInputReceived" and '"sequence":5' in each.data
        ),
        "of equal messages only some become events",
    ),
    "metadata: another version": (
        edits.metadata("robotctl", "robotctl", "9.9.9"),
        "a note tells the version that it claims; all decisions are compared",
    ),
    "ledger: a command more lost": (
        edits.counted(COMMANDS, "lost", 1),
        "it is a loss that nothing contradicts",
    ),
    "status: topic and its name removed": (
        lambda contents, random: edits.metadata("robotctl", "topic.robot_status", None)(
            edits.removed(STATUS)(contents, random), random
        ),
        "recordings of before that do not tell the name, and nothing is decided on a status",
    ),
}
"""Edits that look like an honest recording, with the reason. A sealed recording shows them."""

ON_A_BUTTON: Mapping[str, Kind] = {
    "button: one pressed message released": edits.changed(
        BUTTON, lambda m, _: replace(m, data=m.data[:4] + b"\0"), lambda m: m.data[4] == 1
    ),
    "button: one released message pressed": edits.changed(
        BUTTON, lambda m, _: replace(m, data=m.data[:4] + b"\1"), lambda m: m.data[4] == 0
    ),
    "button: one dropped": edits.dropped(BUTTON, 1, lambda each: 1 < each.sequence < 28),
    "button: one repeated": edits.repeated(BUTTON),
    "button: one with another number": edits.changed(BUTTON, edits.numbered, edits.anywhere),
    "button: one dropped, the others renumbered": edits.dropped_and_renumbered(
        BUTTON, lambda each: each.sequence < 16
    ),
    "button: topic removed": edits.removed(BUTTON),
    "journal: a message of the button dropped": edits.journal(edits.without("SafetyInputReceived")),
    "journal: the press set to released, chained anew": edits.chained_anew(
        edits.rewritten("SafetyInputReceived", r'"value":1\.0', '"value":0.0')
    ),
    "journal: all messages of the button dropped, chained anew": edits.entries_dropped(
        lambda each: each.name == "SafetyInputReceived"
    ),
}
"""Edits that a check finds in a recording with an emergency stop button."""

ONLY_IF_CLOSED: Mapping[str, Kind] = {
    "odometry: the first dropped": edits.dropped(ODOMETRY, 1, lambda each: each.sequence == 1),
    "journal: the last entries dropped, chained anew": edits.chained_anew(edits.last_dropped),
    "commands: any dropped, the others renumbered": edits.dropped_and_renumbered(COMMANDS),
    "journal: a tick dropped, chained anew": edits.chained_anew(edits.without("Tick")),
    "journal: a missed tick added": edits.journal(
        edits.rewritten("Tick", r'"missed":0', '"missed":1')
    ),
    "the end cut off": edits.cut(0.5),
    "the end cut off behind a snapshot": edits.cut_behind_snapshot,
    "status: one dropped": edits.dropped(STATUS),
    "service: all calls removed": edits.all_changed(SET_MODE, lambda m: None),
    "service: a response removed": edits.all_changed(
        SET_MODE, lambda m: None if m.sequence == 2 else m
    ),
    "ledger: a command more received": edits.counted(COMMANDS, "received", 1),
}
"""Edits that are found in a recording that was closed. One that was killed ends anywhere, has no
ledger, and no snapshot after its last entries: an end cut off at a commit is what a kill leaves.
The first inputs may lack, because the recorder finds a publisher later than the control loop."""


def recording_for(kind: str) -> str:
    """Return the recording that an edit of this name needs."""
    if "killed" in kind:
        return "killed"
    return "pressed" if "button" in kind else "stopped"
