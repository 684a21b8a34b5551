"""All kinds of edits, by what a check makes of them."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from random import Random

from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, decode, encode
from robotctl.recording.format.names import EVENT_RECORD
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, Stored
from tests.support.heard_drives import COMMANDS, ESTOP, JOURNAL, SET_MODE, STATUS
from tests.tampering.edits import (
    MOTION,
    Kind,
    all_changed,
    anywhere,
    changed,
    counted,
    cut,
    cut_behind_snapshot,
    decided_without_event,
    dropped,
    dropped_and_renumbered,
    first_part_dropped,
    first_snapshot_dropped,
    journal,
    last_dropped,
    last_number,
    later,
    metadata,
    numbered,
    rare_dropped,
    removed,
    renamed,
    repeated,
    rewritten,
    still,
    swapped,
    two_swapped,
    without,
)
from tests.tampering.topic_kinds import (
    AT_THE_END,
    BUTTON,
    FORGED_MESSAGES,
    FORGED_SCHEMAS,
    IN_TOPICS,
    READ,
    THOUSANDS_OF_THE_BUTTON,
    appended,
    commented,
    described,
    repeated_at_the_end,
)


def one_event(change: dict[str, str]) -> Kind:
    """Change one of the events."""

    def make(contents: Contents, random: Random) -> Contents:
        edited = contents.copy()
        events = [values for name, values in edited.metadata if name == EVENT_RECORD]
        random.choice(events).update(change)
        return edited

    return make


def no_events(contents: Contents, random: Random) -> Contents:
    """Remove all events."""
    edited = contents.copy()
    edited.metadata = [each for each in edited.metadata if each[0] != EVENT_RECORD]
    return edited


FORGED_EVENTS: Mapping[str, Kind] = {
    "events: all removed": no_events,
    "events: another text": one_event({"text": "nothing happened"}),
}
"""Edits that only the seal shows."""


_INPUTS = {"OdomReceived": ODOMETRY, "BatteryReceived": BATTERY}


def stretch_removed(begin_s: float, end_s: float, *, missed: bool = False) -> Kind:
    """Remove what was recorded in a part; the next tick counts the ticks of it if `missed`."""

    def make(contents: Contents, random: Random) -> Contents:
        first_ns = contents.messages[0].log_ns
        begin_ns = first_ns + round(random.uniform(begin_s, begin_s + 0.1) * 1e9)
        gone = _gone(contents, begin_ns, first_ns + round(end_s * 1e9))
        edited = contents.copy()
        edited.messages = list(_numbered(contents, gone, missed=missed))
        return edited

    return make


def _gone(contents: Contents, begin_ns: int, end_ns: int) -> set[int]:
    """Return the places of all messages that go: whole steps, and the inputs of their events."""
    gone: set[int] = set()
    inputs: set[tuple[str, int]] = set()
    is_step = False
    for at, each in enumerate(contents.messages):
        inside = begin_ns <= each.log_ns < end_ns
        if each.topic == JOURNAL:
            entry = decode(each.data)
            is_step = is_step if entry.kind is EntryKind.EFFECT else inside
            inside = is_step
            if inside and entry.name in _INPUTS:
                inputs.add((_INPUTS[entry.name], json.loads(entry.data)["sequence"]))
        if inside and each.topic not in _INPUTS.values():
            gone.add(at)
    return gone | {
        at for at, each in enumerate(contents.messages) if (each.topic, each.sequence) in inputs
    }


def _numbered(contents: Contents, gone: set[int], *, missed: bool) -> list[Stored]:
    """Return the messages that are left, with new numbers and CRCs of the journal."""
    left: list[Stored] = []
    heard, sent = Counter[str](), Counter[str]()
    seq = crc = ticks = 0
    for at, each in enumerate(contents.messages):
        entry = decode(each.data) if each.topic == JOURNAL else None
        if at in gone:
            ticks += entry is not None and entry.name == "Tick"
            continue
        sent[each.topic] += 1
        if entry is None:
            left.append(replace(each, sequence=sent[each.topic]))
            continue
        text = entry.data
        if entry.kind is EntryKind.SNAPSHOT:
            text = re.sub(r'"journal_crc":\d+', f'"journal_crc":{crc}', text)
            text = re.sub(r'"commands":\d+', f'"commands":{sent[COMMANDS]}', text)
        elif entry.name in _INPUTS:
            heard[entry.name] += 1
            text = re.sub(r'"sequence":\d+', f'"sequence":{heard[entry.name]}', text)
        elif entry.name == "Tick" and missed and ticks:
            text, ticks = re.sub(r'"missed":\d+', f'"missed":{ticks}', text), 0
        left.append(_stored(each, entry._replace(seq=seq, data=text)))
        crc = chained(left[-1].data, crc)
        seq += 1
    return left


def _stored(message: Stored, entry: JournalEntry) -> Stored:
    return replace(message, data=encode(entry), sequence=entry.seq + 1)


_LIMITS = r'"linear_mps":[0-9.]+'

IN_JOURNAL: Mapping[str, Kind] = {
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
    "metadata: only observed, the journal received, motion added for 10 s": together(
        OBSERVED, _DRIVEN_ON
    )
}
"""Edits that only the seal shows."""


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


FOUND: Mapping[str, Kind] = {**IN_TOPICS, **IN_JOURNAL, **AT_THE_END, **PRETENDED}
"""Edits that a check finds: its verdict is not `same`."""

FORGED: Mapping[str, Kind] = {**FORGED_EVENTS, **FORGED_NAMES, **FORGED_SCHEMAS, **FORGED_MESSAGES}
"""Edits of each sort that only a forger of an unsealed file makes: the seal shows them."""

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


def recording_for(kind: str) -> str:
    """Return the recording that an edit of this name needs."""
    if "killed" in kind:
        return "killed"
    return "pressed" if "button" in kind else "stopped"
