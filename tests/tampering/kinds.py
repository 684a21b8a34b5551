"""All kinds of edits, by what a check makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from random import Random

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.testing.hearing import BATTERY, ODOMETRY
from robotctl.testing.safety_messages import TOPICS
from tests.support.edited_recordings import Contents, Stored
from tests.support.heard_drives import COMMANDS, JOURNAL, STATUS
from tests.support.service_calls import ESTOP, SET_MODE, received
from tests.tampering.edits import (
    MOTION,
    Kind,
    added,
    all_changed,
    anywhere,
    by_one_ulp,
    changed,
    counted,
    cut,
    dropped,
    dropped_and_renumbered,
    journal,
    last_second_dropped,
    metadata,
    moves,
    removed,
    renamed,
    repeated,
    rewritten,
    still,
    swapped,
    without,
)
from tests.tampering.stretches import stretch_removed

BUTTON = TOPICS[SafetyInput.ESTOP]
"""The topic of the emergency stop button."""


FREQUENT = ("Tick", "OdomReceived", "SafetyInputReceived")


def late(message: Stored) -> Stored:
    """Send a message 2 s later."""
    return replace(message, publish_ns=message.publish_ns + 2 * 10**9)


def early(message: Stored) -> Stored:
    """Send a message 2 s earlier."""
    return replace(message, publish_ns=message.publish_ns - 2 * 10**9)


def moved(message: Stored, random: Random) -> Stored:
    """Change the position, by one bit of any weight."""
    data = bytearray(message.data)
    at = len(data) - 8 * (36 + 6 + 36 + 7) + random.randrange(6)
    data[at] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def level(message: Stored, random: Random) -> Stored:
    """Change the battery level."""
    data = bytearray(message.data)
    data[-4] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def last_number(contents: Contents, topic: str) -> int:
    """Return the number of the last message of a topic."""
    return max(each.sequence for each in contents.messages if each.topic == topic)


def not_first(message: Stored) -> bool:
    """Accept any message but the first."""
    return message.sequence > 1


def not_last(message: Stored) -> bool:
    """Accept the messages that were not under way at the end: a recording has 180 of odometry."""
    return message.sequence < 150


def mode(message: Stored, random: Random) -> Stored:
    """Show a mode that the robot never had."""
    data = bytearray(message.data)
    data[AT_MODE] = Mode.ERROR
    return replace(message, data=bytes(data))


def with_mode(message: Stored, shown: Mode) -> Stored:
    """Show a mode."""
    data = bytearray(message.data)
    data[AT_MODE] = shown.value
    return replace(message, data=bytes(data))


def shown_level(message: Stored, random: Random) -> Stored:
    """Show another battery level."""
    data = bytearray(message.data)
    data[-9] ^= 1 << random.randrange(8)
    return replace(message, data=bytes(data))


def robot(message: Stored, random: Random) -> Stored:
    """Show the status of another robot."""
    return replace(message, data=message.data.replace(b"robot", b"rabot"))


def numbered(message: Stored, random: Random) -> Stored:
    """Give a message another number."""
    return replace(message, sequence=message.sequence + 5_000)


def requested(message: Stored, random: Random) -> Stored:
    """Request another mode."""
    data = bytearray(message.data)
    data[AT_REQUESTED] ^= 1
    return replace(message, data=bytes(data))


def granted(message: Stored, random: Random) -> Stored:
    """Answer the opposite."""
    data = bytearray(message.data)
    data[AT_SUCCESS] ^= 1
    return replace(message, data=bytes(data))


def first_snapshot_dropped(
    entries: list[JournalEntry], random: Random
) -> list[JournalEntry | None]:
    return [None, *entries[1:]]


def first_part_dropped(entries: list[JournalEntry], random: Random) -> list[JournalEntry | None]:
    snapshots = [at for at, each in enumerate(entries) if each.kind is EntryKind.SNAPSHOT]
    first = random.choice(snapshots[1:])
    return [*[None] * first, *entries[first:]]


def rare_dropped(entries: list[JournalEntry], random: Random) -> Sequence[JournalEntry | None]:
    rare = {
        each.name for each in entries if each.kind is EntryKind.EVENT and each.name not in FREQUENT
    }
    return without(random.choice(sorted(rare)))(entries, random)


def last_dropped(entries: list[JournalEntry], random: Random) -> list[JournalEntry | None]:
    count = random.choice((1, 2, 5, 40))
    return [*entries[:-count], *[None] * count]


def two_swapped(entries: list[JournalEntry], random: Random) -> list[JournalEntry | None]:
    """Swap two neighbours, but no two events of the same nanosecond: those have no order."""
    pairs = [
        at
        for at in range(1, len(entries) - 2)
        if entries[at].t_ns != entries[at + 1].t_ns
        or {entries[at].kind, entries[at + 1].kind} != {EntryKind.EVENT}
    ]
    at = random.choice(pairs)
    one, other = entries[at], entries[at + 1]
    entries[at] = other._replace(seq=one.seq)
    entries[at + 1] = one._replace(seq=other.seq)
    return list(entries)


def later(entries: list[JournalEntry], random: Random) -> list[JournalEntry | None]:
    events = [at for at, each in enumerate(entries) if each.kind is EntryKind.EVENT]
    at = random.choice(events)
    entries[at] = entries[at]._replace(t_ns=entries[at].t_ns + 1)
    return list(entries)


def decided_without_event(contents: Contents, random: Random) -> Contents:
    """Drop the entry of one effect, and number the others anew."""
    effects = [
        decode(each.data).seq
        for each in contents.messages
        if each.topic == JOURNAL and decode(each.data).kind is EntryKind.EFFECT
    ]
    gone = random.choice(effects)
    return journal(
        lambda entries, _: [None if each.seq == gone else each for each in entries], careful=True
    )(contents, random)


AT_MODE = 4 + 4 + len(b"robot\0")
"""The place of the mode in a status."""

AT_REQUESTED, AT_SUCCESS = 48, 52
"""The places of the mode in a call and of the success in a response of a service."""

_LIMITS = r'"linear_mps":[0-9.]+'

FOUND: Mapping[str, Kind] = {
    "commands: one that moves dropped": dropped(COMMANDS, 1, moves),
    "commands: any dropped": dropped(COMMANDS),
    "commands: many dropped": dropped(COMMANDS, 30, moves),
    "commands: one dropped, the others renumbered": dropped_and_renumbered(COMMANDS, moves),
    "commands: one changed by an ulp": changed(COMMANDS, by_one_ulp, moves),
    "commands: one that moves set to zero": changed(COMMANDS, lambda m, _: still(m), moves),
    "commands: one zero changed by an ulp": changed(
        COMMANDS, by_one_ulp, lambda each: not moves(each)
    ),
    "commands: one repeated": repeated(COMMANDS),
    "commands: two swapped": swapped(COMMANDS, moves),
    "commands: one with another number": changed(COMMANDS, numbered, moves),
    "commands: one sent late": changed(COMMANDS, lambda m, _: late(m), anywhere),
    "commands: one sent early": changed(COMMANDS, lambda m, _: early(m), anywhere),
    "commands: all sent late": all_changed(COMMANDS, late),
    "commands: all set to zero": all_changed(COMMANDS, still),
    "commands: all that move removed": all_changed(COMMANDS, lambda m: None if moves(m) else m),
    "commands: all removed": all_changed(COMMANDS, lambda m: None),
    "commands: topic removed": removed(COMMANDS),
    "commands: topic renamed": renamed(COMMANDS),
    "commands: motion added": added(COMMANDS, MOTION),
    "odometry: one dropped": dropped(ODOMETRY, 1, not_first),
    "odometry: many dropped": dropped(ODOMETRY, 100, not_first),
    "odometry: those of the last second dropped": last_second_dropped(ODOMETRY),
    "odometry: one dropped, the others renumbered": dropped_and_renumbered(ODOMETRY, not_last),
    "odometry: one moved": changed(ODOMETRY, moved, anywhere),
    "odometry: two swapped": swapped(ODOMETRY, anywhere),
    "odometry: one repeated": repeated(ODOMETRY),
    "odometry: one with another number": changed(ODOMETRY, numbered, anywhere),
    "odometry: all removed": all_changed(ODOMETRY, lambda m: None),
    "odometry: topic renamed": renamed(ODOMETRY),
    "odometry: topic removed": removed(ODOMETRY),
    "battery: one dropped": dropped(BATTERY, 1, not_first),
    "battery: one changed": changed(BATTERY, level, anywhere),
    "battery: one repeated": repeated(BATTERY),
    "battery: topic removed": removed(BATTERY),
    "status: another mode": changed(STATUS, mode, lambda m: m.sequence == 2),
    "status: another battery level": changed(STATUS, shown_level, lambda m: m.sequence > 3),
    "status: the mode before at a change": changed(
        STATUS, lambda m, _: with_mode(m, Mode.IDLE), lambda m: m.sequence == 2
    ),
    "status: the mode of the next change": changed(
        STATUS, lambda m, _: with_mode(m, Mode.IDLE), lambda m: m.sequence in (3, 4)
    ),
    "status: one says that odometry was stale": changed(
        STATUS, lambda m, _: replace(m, data=m.data[:-1] + b"\0"), lambda m: m.sequence > 2
    ),
    "status: one shown late": changed(STATUS, lambda m, _: late(m), lambda m: m.sequence == 2),
    "status: another robot": changed(STATUS, robot, anywhere),
    "status: topic removed": removed(STATUS),
    "status: topic renamed": renamed(STATUS),
    "status: two swapped": swapped(STATUS, anywhere),
    "service: a call for another mode": changed(SET_MODE, requested, lambda m: m.sequence == 1),
    "service: a response says the opposite": changed(SET_MODE, granted, lambda m: m.sequence == 2),
    "service: a call received late": changed(
        ESTOP, lambda m, _: late(m), lambda m: m.sequence == 1
    ),
    "service: a call added": added(ESTOP, received(9, None)),
    "service: a request added to the journal, chained anew": journal(
        rewritten("ModeRequested", '"the ROS service /estop"', '"the ROS service /set_mode"'),
        careful=True,
    ),
    "journal: an entry dropped": dropped(JOURNAL),
    "journal: an entry repeated": repeated(JOURNAL),
    "journal: two entries swapped": journal(two_swapped),
    "journal: two entries swapped, chained anew": journal(two_swapped, careful=True),
    "journal: an event one ns later": journal(later),
    "journal: the first snapshot dropped": journal(first_snapshot_dropped),
    "journal: the first snapshot dropped, chained anew": journal(
        first_snapshot_dropped, careful=True
    ),
    "journal: all before a later snapshot dropped, chained anew": journal(
        first_part_dropped, careful=True
    ),
    "journal: an event of rare kind dropped": journal(rare_dropped),
    "journal: an event of rare kind dropped, chained anew": journal(rare_dropped, careful=True),
    "journal: a tick dropped": journal(without("Tick")),
    "journal: odometry dropped": journal(without("OdomReceived")),
    "journal: a battery level dropped": journal(without("BatteryReceived")),
    "journal: a request dropped, chained anew": journal(without("ModeRequested"), careful=True),
    "journal: the drive dropped, chained anew": journal(without("DriveRequested"), careful=True),
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
    "journal: the source of a request changed": journal(
        rewritten("DriveRequested", r'"source":"operator"', '"source":"nobody"')
    ),
    "journal: a limit changed in one snapshot, chained anew": journal(
        rewritten("Snapshot", _LIMITS, '"linear_mps":0.59'), careful=True
    ),
    "journal: a limit changed in all snapshots, chained anew": journal(
        rewritten("Snapshot", _LIMITS, '"linear_mps":0.59', everywhere=True), careful=True
    ),
    "journal: the number of commands changed in all snapshots, chained anew": journal(
        rewritten("Snapshot", r'"commands":[0-9]+', '"commands":7', everywhere=True), careful=True
    ),
    "journal: topic removed": removed(JOURNAL),
    "all topics: a stretch of standing removed, all numbered and chained anew": stretch_removed(
        1.3, 1.6
    ),
    "metadata: the limit of the velocity changed": metadata(
        "robotctl", "parameter.limits.linear_mps", "0.59"
    ),
    "metadata: the topic of the commands changed": metadata(
        "robotctl", "parameter.command.topic", "other"
    ),
    "metadata: the topic of odometry changed": metadata(
        "robotctl", "parameter.odometry.topic", "other"
    ),
}
"""Edits that a check finds: its verdict is not `same`."""

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
    "button: two swapped": swapped(BUTTON, anywhere),
    "button: all released": all_changed(BUTTON, lambda m: replace(m, data=m.data[:4] + b"\0")),
    "button: topic removed": removed(BUTTON),
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
    "status: one dropped": dropped(STATUS),
    "status: all removed": all_changed(STATUS, lambda m: None),
    "service: all calls removed": all_changed(SET_MODE, lambda m: None),
    "service: topic removed": removed(ESTOP),
    "service: topic renamed": renamed(ESTOP),
    "service: a response removed": all_changed(SET_MODE, lambda m: None if m.sequence == 2 else m),
    "ledger: a command more received": counted(COMMANDS, "received", 1),
    "ledger: a command more written": counted(COMMANDS, "written", 1),
}
"""Edits that are found in a recording that was closed. One that was killed ends anywhere, has no
ledger, and no snapshot after its last entries: an end cut off at a commit is what a kill leaves.
The first inputs may lack, because the recorder finds a publisher later than the control loop."""

ACCEPTED: Mapping[str, tuple[Kind, str]] = {
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
    "metadata: the mode at the start changed": (
        metadata("robotctl", "mode", "MOVING"),
        "no decision depends on it: the journal holds the mode",
    ),
}
"""Edits that look like an honest recording, with the reason. A sealed recording shows them."""
