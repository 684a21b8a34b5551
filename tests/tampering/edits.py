"""Tools of a forger: each returns edited contents whose CRCs, indexes and counts agree."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Concatenate, ParamSpec

from mcap.records import Channel, Schema

from robotctl.check.report import Report
from robotctl.check.run import check_recording
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.messages.definition import parse_definition, rihs01_hash
from robotctl.messages.inputs import decode_twist, encode_twist
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, decode, encode
from robotctl.recording.format.names import LEDGER_RECORD
from tests.support.edited_recordings import Contents, Stored, edit, write_contents
from tests.support.heard_drives import JOURNAL, received

Kind = Callable[[Contents, Random], Contents]
"""An edit; the generator chooses its place."""

Entries = Sequence[JournalEntry | None]
"""A journal; an entry in the place of None is dropped."""

EntriesEdit = Callable[[list[JournalEntry], Random], Entries]
P = ParamSpec("P")


def kind(make: Callable[Concatenate[Contents, Random, P], Contents]) -> Callable[P, Kind]:
    """Make of an edit with arguments the function that binds these."""
    return lambda *args, **options: (
        lambda contents, random: make(contents, random, *args, **options)
    )


def check_edited(folder: Path, contents: Contents, *edits: Kind) -> Report:
    """Check a recording after edits, one after the other."""
    for each in edits:
        contents = each(contents, Random(1))
    return check_recording(write_contents(folder / "run", contents))


def positions(contents: Contents, topic: str, wanted: Callable[[Stored], bool]) -> list[int]:
    """Return the places among the messages of a topic that are `wanted`."""
    of_topic = [each for each in contents.messages if each.topic == topic]
    return [at for at, each in enumerate(of_topic) if wanted(each)]


def anywhere(message: Stored) -> bool:
    """Accept any message."""
    return True


def moves(message: Stored) -> bool:
    """Accept a command that is not zero."""
    twist = decode_twist(message.data)
    return bool(twist.linear or twist.angular)


@kind
def dropped(
    contents: Contents,
    random: Random,
    topic: str,
    count: int = 1,
    wanted: Callable[[Stored], bool] = anywhere,
) -> Contents:
    """Drop messages in a row."""
    first = random.choice(positions(contents, topic, wanted)[: -count or None])
    gone = range(first, first + count)
    return edit(contents, topic, lambda at, each: None if at in gone else each)


@kind
def dropped_and_renumbered(
    contents: Contents, random: Random, topic: str, wanted: Callable[[Stored], bool] = anywhere
) -> Contents:
    """Drop a message, and close the gap in the numbers."""
    first = random.choice(positions(contents, topic, wanted))

    def change(at: int, each: Stored) -> Stored | None:
        if at == first:
            return None
        return replace(each, sequence=each.sequence - 1) if at > first else each

    return edit(contents, topic, change)


@kind
def changed(
    contents: Contents,
    random: Random,
    topic: str,
    change: Callable[[Stored, Random], Stored],
    wanted: Callable[[Stored], bool],
) -> Contents:
    """Change one message."""
    chosen = random.choice(positions(contents, topic, wanted))
    return edit(contents, topic, lambda at, each: change(each, random) if at == chosen else each)


@kind
def all_changed(
    contents: Contents, random: Random, topic: str, change: Callable[[Stored], Stored | None]
) -> Contents:
    """Change every message of a topic."""
    return edit(contents, topic, lambda at, each: change(each))


@kind
def last_second_dropped(contents: Contents, random: Random, topic: str) -> Contents:
    """Drop the messages of the last second."""
    end_ns = max(each.log_ns for each in contents.messages)
    return edit(contents, topic, lambda at, each: each if end_ns - each.log_ns > 10**9 else None)


@kind
def repeated(
    contents: Contents, random: Random, topic: str, wanted: Callable[[Stored], bool] = anywhere
) -> Contents:
    """Record a message twice."""
    edited = contents.copy()
    places = [i for i, each in enumerate(edited.messages) if each.topic == topic and wanted(each)]
    chosen = random.choice(places)
    edited.messages.insert(chosen + random.randrange(1, 30), edited.messages[chosen])
    return edited


@kind
def swapped(
    contents: Contents, random: Random, topic: str, wanted: Callable[[Stored], bool]
) -> Contents:
    """Exchange the contents of two messages that differ."""
    of_topic = [each for each in contents.messages if each.topic == topic]
    first = random.choice(positions(contents, topic, wanted))
    other = random.choice(
        [at for at, each in enumerate(of_topic) if each.data != of_topic[first].data]
    )
    data = {first: of_topic[other].data, other: of_topic[first].data}
    return edit(contents, topic, lambda at, each: replace(each, data=data.get(at, each.data)))


@kind
def added(contents: Contents, random: Random, topic: str, data: bytes) -> Contents:
    """Add a message with the next number, and shift the numbers after it."""
    places = [i for i, each in enumerate(contents.messages) if each.topic == topic]
    chosen = random.choice(places[:-1])
    edited = edit(contents, topic, lambda at, each: each)
    before = contents.messages[chosen]
    edited.messages = [
        replace(each, sequence=each.sequence + 1)
        if each.topic == topic and each.sequence > before.sequence
        else each
        for each in contents.messages
    ]
    extra = replace(before, data=data, sequence=before.sequence + 1)
    edited.messages.insert(chosen + 1, extra)
    return edited


@kind
def removed(contents: Contents, random: Random, topic: str) -> Contents:
    """Remove a topic that has messages, with its channel."""
    random.choice(positions(contents, topic, anywhere))
    return contents.without(topic)


@kind
def renamed(contents: Contents, random: Random, topic: str) -> Contents:
    """Give a topic that has messages another name, also in the ledger."""
    random.choice(positions(contents, topic, anywhere))
    name = f"/other{topic}"
    edited = edit(contents, topic, lambda at, each: replace(each, topic=name))
    edited.types = [
        (replace(channel, topic=name) if channel.topic == topic else channel, schema)
        for channel, schema in edited.types
    ]
    edited.counts = Counter(each.topic for each in edited.messages)
    for record, values in edited.metadata:
        if record == LEDGER_RECORD:
            values[name] = values.pop(topic)
    return edited


def still(message: Stored) -> Stored:
    """Replace a command with zero."""
    return replace(message, data=message.data[:4] + bytes(48))


MOTION = encode_twist(replace(decode_twist(bytes((0, 1, 0, 0)) + bytes(48)), linear=0.2))
"""A command to go forward."""


# The journal


@kind
def journal(
    contents: Contents, random: Random, change: EntriesEdit, *, careful: bool = False
) -> Contents:
    """Change journal entries; a careful forger numbers them anew and computes the CRCs again.

    `change` returns the entries in their places; None is dropped.
    """
    entries = [decode(each.data) for each in contents.messages if each.topic == JOURNAL]
    left = change(list(entries), random)
    assert len(left) == len(entries)
    if careful:
        left = _renumbered(left)

    def keep(at: int, each: Stored) -> Stored | None:
        entry = left[at]
        if entry is None:
            return None
        return replace(each, data=encode(entry), sequence=entry.seq + 1)

    return edit(contents, JOURNAL, keep)


def chained_anew(change: EntriesEdit) -> Kind:
    """Change journal entries as a careful forger."""
    return journal(change, careful=True)


def entries_dropped(is_dropped: Callable[[JournalEntry], bool]) -> Kind:
    """Drop journal entries, and chain the others anew."""
    return chained_anew(lambda entries, _: [None if is_dropped(e) else e for e in entries])


def _renumbered(entries: Entries) -> Entries:
    again: list[JournalEntry | None] = []
    seq = crc = 0
    for entry in entries:
        if entry is not None:
            text = entry.data
            if entry.kind is EntryKind.SNAPSHOT:
                text = re.sub(r'"journal_crc":[0-9]+', f'"journal_crc":{crc}', text)
            entry = entry._replace(seq=seq, data=text)
            crc = chained(encode(entry), crc)
            seq += 1
        again.append(entry)
    return again


def without(name: str) -> EntriesEdit:
    """Drop an event of this name with its effects, but not the last one, as a kill does."""

    def change(entries: list[JournalEntry], random: Random) -> Entries:
        left: list[JournalEntry | None] = list(entries)
        last = max(at for at, entry in enumerate(entries) if entry.kind is EntryKind.EVENT)
        places = [at for at in range(last) if entries[at].name == name]
        at = random.choice(places)
        left[at] = None
        for after in range(at + 1, len(entries)):
            if entries[after].kind is not EntryKind.EFFECT:
                break
            left[after] = None
        return left

    return change


def rewritten(name: str, pattern: str, text: str, *, everywhere: bool = False) -> EntriesEdit:
    """Replace text in an entry of this name, or in all of them."""

    def change(entries: list[JournalEntry], random: Random) -> Entries:
        places = [
            at
            for at, entry in enumerate(entries)
            if entry.name == name and re.search(pattern, entry.data)
        ]
        for at in places if everywhere else [random.choice(places)]:
            data = re.sub(pattern, text, entries[at].data, count=1)
            entries[at] = entries[at]._replace(data=data)
        return entries

    return change


# Metadata and counts


@kind
def metadata(
    contents: Contents, random: Random, record: str, key: str, value: str | None
) -> Contents:
    """Change a value of the metadata; None removes it."""
    edited = contents.copy()
    for name, values in edited.metadata:
        if name == record:
            values.pop(key, None)
            if value is not None:
                values[key] = value
    return edited


@kind
def counted(contents: Contents, random: Random, topic: str, count: str, more: int) -> Contents:
    """Change a count of the ledger."""
    edited = contents.copy()
    for name, values in edited.metadata:
        if name == "robotctl.ledger":
            counts = json.loads(values[topic])
            values[topic] = json.dumps({**counts, count: counts[count] + more})
    return edited


def cut_behind_snapshot(contents: Contents, random: Random) -> Contents:
    """Cut off the end of all topics, so that a snapshot is the last entry of the journal."""
    edited = contents.copy()
    del edited.messages[random.choice(contents.snapshots()[1:-1]) + 1 :]
    return edited


@kind
def cut(contents: Contents, random: Random, share: float) -> Contents:
    """Cut off the end of all topics, at a place in the last part of the file."""
    edited = contents.copy()
    keep = round(len(contents.messages) * (1 - random.uniform(0.02, share)))
    del edited.messages[keep:]
    return edited


AT_MODE = 4 + 4 + len(b"robot\0")
"""The place of the mode in a status."""

AT_REQUESTED, AT_SUCCESS = 48, 52
"""The places of the mode in a call and of the success in a response of a service."""


def late(message: Stored) -> Stored:
    """Send a message 2 s later."""
    return replace(message, publish_ns=message.publish_ns + 2 * 10**9)


def early(message: Stored) -> Stored:
    """Send a message 2 s earlier."""
    return replace(message, publish_ns=message.publish_ns - 2 * 10**9)


def _with_bit(message: Stored, at: int, bit: int) -> Stored:
    """Flip a bit of the byte at this place."""
    data = bytearray(message.data)
    data[at] ^= 1 << bit
    return replace(message, data=bytes(data))


def moved(message: Stored, random: Random) -> Stored:
    """Change the position, by one bit of any weight."""
    at = random.randrange(6) - 8 * (36 + 6 + 36 + 7)
    return _with_bit(message, at, random.randrange(8))


def level(message: Stored, random: Random) -> Stored:
    """Change the battery level."""
    return _with_bit(message, -4, random.randrange(8))


def last_number(contents: Contents, topic: str) -> int:
    """Return the number of the last message of a topic."""
    return max(each.sequence for each in contents.messages if each.topic == topic)


def not_first(message: Stored) -> bool:
    """Accept any message but the first."""
    return message.sequence > 1


def not_last(message: Stored) -> bool:
    """Accept the messages that were not under way at the end: a recording has 180 of odometry."""
    return message.sequence < 150


def with_mode(message: Stored, shown: Mode) -> Stored:
    """Show a mode."""
    data = bytearray(message.data)
    data[AT_MODE] = shown.value
    return replace(message, data=bytes(data))


def robot(message: Stored, random: Random) -> Stored:
    """Show the status of another robot."""
    return replace(message, data=message.data.replace(b"robot", b"rabot"))


def numbered(message: Stored, random: Random) -> Stored:
    """Give a message another number."""
    return replace(message, sequence=message.sequence + 5_000)


def flipped(at: int) -> Callable[[Stored, Random], Stored]:
    """Flip the last bit of the byte at this place."""
    return lambda message, random: _with_bit(message, at, 0)


by_one_ulp = flipped(4)
"""Change the last bit of the forward velocity of a command."""

FREQUENT = ("Tick", "OdomReceived", "SafetyInputReceived")


def rare_dropped(entries: list[JournalEntry], random: Random) -> Entries:
    rare = {
        each.name for each in entries if each.kind is EntryKind.EVENT and each.name not in FREQUENT
    }
    return without(random.choice(sorted(rare)))(entries, random)


def last_dropped(entries: list[JournalEntry], random: Random) -> Entries:
    count = random.choice((1, 2, 5, 40))
    return [*entries[:-count], *[None] * count]


def two_swapped(entries: list[JournalEntry], random: Random) -> Entries:
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


def later(entries: list[JournalEntry], random: Random) -> Entries:
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
    return entries_dropped(lambda each: each.seq == gone)(contents, random)


# Topics: after their ends, and what the file tells of them

Change = Callable[[Stored], Stored]
"""Makes of the last message what is added."""

Described = tuple[Channel, Schema]


@kind
def appended(
    contents: Contents,
    random: Random,
    topic: str,
    counts: tuple[int, int],
    change: Change = lambda message: message,
    *,
    step: int = 1,
    first: int = 1,
    every_s: float = 0.0,
    after_s: float = 0.0,
) -> Contents:
    """Add messages after the last one of a topic, so many at least and at most.

    Numbers: `first`, then in steps of `step`. Times: `after_s` after the end, then each `every_s`.
    """
    last = [each for each in contents.messages if each.topic == topic][-1]
    end_ns = max(each.log_ns for each in contents.messages)
    begin_ns = end_ns + round(after_s * NS_PER_S)
    edited = contents.copy()
    for number in range(random.randint(*counts)):
        at_ns = begin_ns + round(number * every_s * NS_PER_S)
        sequence = last.sequence + (first + number) * step
        message = replace(last, log_ns=at_ns, publish_ns=at_ns, sequence=sequence)
        edited.messages.append(change(message))
    return edited


@kind
def repeated_at_the_end(
    contents: Contents, random: Random, topic: str, counts: tuple[int, int], change: Change
) -> Contents:
    """Repeat the last message of a topic, so often at least and at most."""
    last = [each for each in contents.messages if each.topic == topic][-1]
    edited = contents.copy()
    edited.messages += [change(last)] * random.randint(*counts)
    return edited


def call(message: Stored) -> Stored:
    """Make a call of a service, each of another client's."""
    return replace(message, data=received(message.sequence, None))


@kind
def described(
    contents: Contents, random: Random, change: Callable[[Channel, Schema], Described], *topics: str
) -> Contents:
    """Change what the file tells of one of these topics."""
    chosen = random.choice(topics)
    edited = contents.copy()
    edited.types = [
        change(channel, schema) if channel.topic == chosen else (channel, schema)
        for channel, schema in contents.types
    ]
    return edited


def with_type_hash(channel: Channel, schema: Schema, text: str) -> Described:
    """Change the type hash that a channel tells."""
    return replace(channel, metadata={**channel.metadata, "topic_type_hash": text}), schema


def of_another_version(channel: Channel, schema: Schema) -> Described:
    """Add a field to a type, with the hash that it then has."""
    text = b"uint8 another\n" + schema.data
    type_hash = rihs01_hash(schema.name, parse_definition(schema.name, text.decode()))
    return with_type_hash(channel, replace(schema, data=text), type_hash)
