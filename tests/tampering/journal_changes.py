"""Changes of a journal: each returns the entries in their places, None for one that is dropped."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from tests.support.edited_recordings import Contents
from tests.support.heard_drives import JOURNAL
from tests.tampering.edits import journal, without

FREQUENT = ("Tick", "OdomReceived", "SafetyInputReceived")


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
