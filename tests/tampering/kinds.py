"""All kinds of edits, by what a check makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.testing.hearing import BATTERY, ODOMETRY, TOPICS
from tests.support.heard_drives import COMMANDS, ESTOP, JOURNAL, SET_MODE, STATUS, received
from tests.tampering.edits import (
    AT_REQUESTED,
    AT_SUCCESS,
    MOTION,
    Kind,
    added,
    all_changed,
    anywhere,
    appended,
    by_one_ulp,
    call,
    changed,
    counted,
    cut,
    cut_behind_snapshot,
    decided_without_event,
    described,
    dropped,
    dropped_and_renumbered,
    early,
    entries_dropped,
    flipped,
    journal,
    last_dropped,
    last_number,
    last_second_dropped,
    late,
    later,
    level,
    metadata,
    moved,
    moves,
    not_first,
    not_last,
    numbered,
    of_another_version,
    rare_dropped,
    removed,
    renamed,
    repeated,
    repeated_at_the_end,
    rewritten,
    robot,
    still,
    swapped,
    two_swapped,
    with_mode,
    with_type_hash,
    without,
)

BUTTON = TOPICS[SafetyInput.ESTOP]
"""The topic of the emergency stop button."""

READ = (COMMANDS, ODOMETRY, BATTERY, STATUS, JOURNAL, SET_MODE, ESTOP)
"""The topics whose messages a check reads."""

_LIMITS = r'"linear_mps":[0-9.]+'

FOUND: Mapping[str, Kind] = {
    "schema: of another version, with its hash": described(of_another_version, *READ),
    "channel: no type hash": described(
        lambda channel, schema: with_type_hash(channel, schema, ""), *READ
    ),
    "channel: another encoding": described(
        lambda channel, schema: (replace(channel, message_encoding="json"), schema),
        *(COMMANDS, ODOMETRY, BATTERY, STATUS),
    ),
    "commands: any dropped": dropped(COMMANDS),
    "commands: one dropped, the others renumbered": dropped_and_renumbered(COMMANDS, moves),
    "commands: one changed by an ulp": changed(COMMANDS, by_one_ulp, moves),
    "commands: one that moves set to zero": changed(COMMANDS, lambda m, _: still(m), moves),
    "commands: one repeated": repeated(COMMANDS),
    "commands: two swapped": swapped(COMMANDS, moves),
    "commands: one with another number": changed(COMMANDS, numbered, moves),
    "commands: one sent late": changed(COMMANDS, lambda m, _: late(m), anywhere),
    "commands: one sent early": changed(COMMANDS, lambda m, _: early(m), anywhere),
    "commands: all removed": all_changed(COMMANDS, lambda m: None),
    "commands: topic removed": removed(COMMANDS),
    "commands: topic renamed": renamed(COMMANDS),
    "commands: motion added": added(COMMANDS, MOTION),
    "odometry: one dropped": dropped(ODOMETRY, 1, not_first),
    "odometry: those of the last second dropped": last_second_dropped(ODOMETRY),
    "odometry: one dropped, the others renumbered": dropped_and_renumbered(ODOMETRY, not_last),
    "odometry: one moved": changed(ODOMETRY, moved, anywhere),
    "odometry: one repeated": repeated(ODOMETRY),
    "odometry: one with another number": changed(ODOMETRY, numbered, anywhere),
    "odometry: topic removed": removed(ODOMETRY),
    "battery: one dropped": dropped(BATTERY, 1, not_first),
    "battery: one changed": changed(BATTERY, level, anywhere),
    "battery: topic removed": removed(BATTERY),
    "status: another mode": changed(
        STATUS, lambda m, _: with_mode(m, Mode.ERROR), lambda m: m.sequence == 2
    ),
    "status: another robot": changed(STATUS, robot, anywhere),
    "status: topic removed": removed(STATUS),
    "service: a call for another mode": changed(
        SET_MODE, flipped(AT_REQUESTED), lambda m: m.sequence == 1
    ),
    "service: a response says the opposite": changed(
        SET_MODE, flipped(AT_SUCCESS), lambda m: m.sequence == 2
    ),
    "service: a call received late": changed(
        ESTOP, lambda m, _: late(m), lambda m: m.sequence == 1
    ),
    "service: a call added": added(ESTOP, received(9, None)),
    "commands: zeros with numbers beyond all decisions added at the end": appended(
        COMMANDS, (1, 300), still, first=5_000
    ),
    "commands: some zeros added at the end, at once": appended(COMMANDS, (5, 20), still),
    "commands: zeros with one number added at the end": appended(COMMANDS, (5, 60), still, step=0),
    "commands: motion added at the end": appended(
        COMMANDS, (1, 100), lambda message: replace(message, data=MOTION)
    ),
    "odometry: some added later": appended(ODOMETRY, (1, 20), every_s=0.02, after_s=3.0),
    "status: the last one repeated at the end": repeated_at_the_end(
        STATUS, (5, 60), lambda message: message
    ),
    "status: the last one repeated at the end, with another mode": repeated_at_the_end(
        STATUS, (1, 1), lambda message: with_mode(message, Mode.ERROR)
    ),
    "service: responses added at the end": appended(ESTOP, (1, 300)),
    "service: some calls added later": appended(ESTOP, (1, 20), call, every_s=0.1, after_s=3.0),
    "journal: an entry dropped": dropped(JOURNAL),
    "journal: an entry repeated": repeated(JOURNAL),
    "journal: two entries swapped": journal(two_swapped),
    "journal: an event one ns later": journal(later),
    "journal: an event of rare kind dropped, chained anew": journal(rare_dropped, careful=True),
    "journal: a tick dropped": journal(without("Tick")),
    "journal: odometry dropped": journal(without("OdomReceived")),
    "journal: an effect dropped, chained anew": decided_without_event,
    "journal: odometry changed, chained anew": journal(
        rewritten("OdomReceived", r'"x":([-0-9.e]+)', r'"x":1.5'), careful=True
    ),
    "journal: a battery level changed, chained anew": journal(
        rewritten("BatteryReceived", r'"level":[0-9.]+', '"level":0.77'), careful=True
    ),
    "journal: a command changed, chained anew": journal(
        rewritten("PublishTwist", r'"linear":0\.', '"linear":0.1'), careful=True
    ),
    "journal: a reason changed, chained anew": journal(
        rewritten("ModeChanged", r'"reason":"', '"reason":"not '), careful=True
    ),
    "journal: a limit changed in all snapshots, chained anew": journal(
        rewritten("Snapshot", _LIMITS, '"linear_mps":0.59', everywhere=True), careful=True
    ),
    "journal: topic removed": removed(JOURNAL),
    "metadata: the limit of the velocity changed": metadata(
        "robotctl", "parameter.limits.linear_mps", "0.59"
    ),
    "metadata: the topic of the commands changed": metadata(
        "robotctl", "parameter.command.topic", "other"
    ),
}
"""Edits that a check finds: its verdict is not `same`."""

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
        entries_dropped(lambda each: each.name == "OdomReceived" and '"sequence":2,' in each.data),
        "the control loop takes its inputs with best effort, and the CRCs were computed again",
    ),
    "journal: one of equal messages of the button dropped, chained anew": (
        entries_dropped(
            lambda each: each.name == "SafetyInputReceived" and '"sequence":5' in each.data
        ),
        "of equal messages only some become events",
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
}
"""Edits that look like an honest recording, with the reason. A sealed recording shows them."""

ON_A_BUTTON: Mapping[str, Kind] = {
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
    "button: topic removed": removed(BUTTON),
    "journal: a message of the button dropped": journal(without("SafetyInputReceived")),
    "journal: the press set to released, chained anew": journal(
        rewritten("SafetyInputReceived", r'"value":1\.0', '"value":0.0'), careful=True
    ),
    "journal: all messages of the button dropped, chained anew": entries_dropped(
        lambda each: each.name == "SafetyInputReceived"
    ),
}
"""Edits that a check finds in a recording with an emergency stop button."""

ONLY_IF_CLOSED: Mapping[str, Kind] = {
    "odometry: the first dropped": dropped(ODOMETRY, 1, lambda each: each.sequence == 1),
    "journal: the last entries dropped, chained anew": journal(last_dropped, careful=True),
    "commands: any dropped, the others renumbered": dropped_and_renumbered(COMMANDS),
    "journal: a tick dropped, chained anew": journal(without("Tick"), careful=True),
    "journal: a missed tick added": journal(rewritten("Tick", r'"missed":0', '"missed":1')),
    "the end cut off": cut(0.5),
    "the end cut off behind a snapshot": cut_behind_snapshot,
    "status: one dropped": dropped(STATUS),
    "service: all calls removed": all_changed(SET_MODE, lambda m: None),
    "service: a response removed": all_changed(SET_MODE, lambda m: None if m.sequence == 2 else m),
    "ledger: a command more received": counted(COMMANDS, "received", 1),
}
"""Edits that are found in a recording that was closed. One that was killed ends anywhere, has no
ledger, and no snapshot after its last entries: an end cut off at a commit is what a kill leaves.
The first inputs may lack, because the recorder finds a publisher later than the control loop."""


def recording_for(kind: str) -> str:
    """Return the recording that an edit of this name needs."""
    if "killed" in kind:
        return "killed"
    return "pressed" if "button" in kind else "stopped"
