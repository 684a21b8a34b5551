"""Edits of the recorded topics: of their messages, schemas and times, and after their ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from random import Random

from mcap.records import Channel, Schema

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.messages.definition import parse_definition, rihs01_hash
from robotctl.testing.hearing import BATTERY, ODOMETRY, TOPICS
from tests.support.edited_recordings import Contents, Stored
from tests.support.heard_drives import COMMANDS, ESTOP, JOURNAL, SET_MODE, STATUS, received
from tests.tampering.edits import (
    AT_REQUESTED,
    AT_SUCCESS,
    MOTION,
    Kind,
    added,
    all_changed,
    anywhere,
    by_one_ulp,
    changed,
    dropped,
    dropped_and_renumbered,
    early,
    flipped,
    journal,
    last_second_dropped,
    late,
    level,
    moved,
    moves,
    not_first,
    not_last,
    numbered,
    removed,
    renamed,
    repeated,
    rewritten,
    robot,
    still,
    swapped,
    with_mode,
)

BUTTON = TOPICS[SafetyInput.ESTOP]
"""The topic of the emergency stop button."""

Change = Callable[[Stored], Stored]
"""Makes of the last message what is added."""

THOUSANDS = 2_000, 5_000


def appended(
    topic: str,
    counts: tuple[int, int],
    change: Change = lambda message: message,
    *,
    step: int = 1,
    first: int = 1,
    every_s: float = 0.0,
    after_s: float = 0.0,
) -> Kind:
    """Add messages after the last one of a topic, so many at least and at most.

    They are numbered in steps of `step`, `first` for the first one; they follow the end of the
    recording `after_s` later, and each other in `every_s`.
    """

    def make(contents: Contents, random: Random) -> Contents:
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

    return make


def repeated_at_the_end(topic: str, counts: tuple[int, int], change: Change) -> Kind:
    """Repeat the last message of a topic, so often at least and at most."""

    def make(contents: Contents, random: Random) -> Contents:
        last = [each for each in contents.messages if each.topic == topic][-1]
        edited = contents.copy()
        edited.messages += [change(last)] * random.randint(*counts)
        return edited

    return make


def call(message: Stored) -> Stored:
    """Make a call of a service, each of another client's."""
    return replace(message, data=received(message.sequence, None))


AT_THE_END: Mapping[str, Kind] = {
    "commands: zeros with numbers beyond all decisions added at the end": appended(
        COMMANDS, (1, 3_000), still, first=5_000
    ),
    "commands: zeros added at the end, at once": appended(COMMANDS, THOUSANDS, still),
    "commands: some zeros added at the end, at once": appended(COMMANDS, (5, 20), still),
    "commands: zeros added at the end, for a minute": appended(
        COMMANDS, (1_200, 1_200), still, every_s=0.05
    ),
    "commands: zeros with one number added at the end": appended(
        COMMANDS, THOUSANDS, still, step=0
    ),
    "commands: motion added at the end": appended(
        COMMANDS, (1, 100), lambda message: replace(message, data=MOTION)
    ),
    "odometry: thousands added at the end": appended(ODOMETRY, THOUSANDS),
    "odometry: some added later": appended(ODOMETRY, (1, 20), every_s=0.02, after_s=3.0),
    "battery: thousands added at the end": appended(BATTERY, THOUSANDS),
    "battery: some added later": appended(BATTERY, (3, 60), every_s=1.0, after_s=1.0),
    "status: the last one repeated at the end": repeated_at_the_end(
        STATUS, THOUSANDS, lambda message: message
    ),
    "status: the last one repeated at the end, with another mode": repeated_at_the_end(
        STATUS, (1, 1), lambda message: with_mode(message, Mode.ERROR)
    ),
    "status: the last one repeated before it was sent": repeated_at_the_end(
        STATUS, THOUSANDS, lambda message: replace(message, log_ns=message.publish_ns - 1)
    ),
    "service: responses added at the end": appended(ESTOP, (1, 3_000)),
    "service: thousands of calls added at the end": appended(ESTOP, THOUSANDS, call),
    "service: some calls added later": appended(ESTOP, (1, 20), call, every_s=0.1, after_s=3.0),
}
"""Edits that a check finds."""

THOUSANDS_OF_THE_BUTTON: Kind = appended(BUTTON, THOUSANDS)


Described = tuple[Channel, Schema]

READ = (COMMANDS, ODOMETRY, BATTERY, STATUS, JOURNAL, SET_MODE, ESTOP)
"""The topics whose messages a check reads."""


def described(change: Callable[[Channel, Schema], Described], *topics: str) -> Kind:
    """Change what the file tells of one of these topics."""

    def make(contents: Contents, random: Random) -> Contents:
        chosen = random.choice(topics)
        edited = contents.copy()
        edited.types = [
            change(channel, schema) if channel.topic == chosen else (channel, schema)
            for channel, schema in contents.types
        ]
        return edited

    return make


def exchanged(one: str, other: str) -> Callable[[Channel, Schema], Described]:
    """Exchange two names in the text of a type."""

    def change(channel: Channel, schema: Schema) -> Described:
        text = schema.data.decode()
        assert one in text
        text = text.replace(one, "\0").replace(other, one).replace("\0", other)
        return channel, replace(schema, data=text.encode())

    return change


def told(key: str, value: str) -> Callable[[Channel, Schema], Described]:
    """Change the metadata of a channel."""
    return lambda channel, schema: (
        replace(channel, metadata={**channel.metadata, key: value}),
        schema,
    )


def of_another_version(channel: Channel, schema: Schema) -> Described:
    """Add a field to a type, with the hash that it then has."""
    text = b"uint8 another\n" + schema.data
    type_hash = rihs01_hash(schema.name, parse_definition(schema.name, text.decode()))
    return told("topic_type_hash", type_hash)(channel, replace(schema, data=text))


def commented(channel: Channel, schema: Schema) -> Described:
    """Change the comments of a type."""
    return channel, replace(schema, data=b"# in furlongs per fortnight\n" + schema.data)


IN_SCHEMAS: Mapping[str, Kind] = {
    "schema: of another version, with its hash": described(of_another_version, *READ),
    "channel: another type hash": described(told("topic_type_hash", f"RIHS01_{0:064}"), *READ),
    "channel: no type hash": described(told("topic_type_hash", ""), *READ),
    "channel: another encoding": described(
        lambda channel, schema: (replace(channel, message_encoding="json"), schema),
        *(COMMANDS, ODOMETRY, BATTERY, STATUS),
    ),
}
"""Edits that a check finds."""

FORGED_SCHEMAS: Mapping[str, Kind] = {
    "schema: linear and angular exchanged": described(exchanged(" linear", " angular"), COMMANDS),
    "channel: no quality of service": described(told("offered_qos_profiles", ""), STATUS, JOURNAL),
}
"""Edits that only the seal shows."""


IN_TOPICS: Mapping[str, Kind] = {
    **IN_SCHEMAS,
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
    "status: another mode": changed(
        STATUS, lambda m, _: with_mode(m, Mode.ERROR), lambda m: m.sequence == 2
    ),
    "status: another robot": changed(STATUS, robot, anywhere),
    "status: topic removed": removed(STATUS),
    "status: topic renamed": renamed(STATUS),
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
    "service: a request added to the journal, chained anew": journal(
        rewritten("ModeRequested", '"the ROS service /estop"', '"the ROS service /set_mode"'),
        careful=True,
    ),
}

FORGED_MESSAGES: Mapping[str, Kind] = {
    "status: the mode before at a change": changed(
        STATUS, lambda m, _: with_mode(m, Mode.IDLE), lambda m: m.sequence == 2
    ),
    "journal: one entry recorded an hour later": changed(
        JOURNAL,
        lambda m, _: replace(m, log_ns=m.log_ns + 3_600 * NS_PER_S),
        lambda m: m.sequence < 400,
    ),
}
"""Edits that only the seal shows."""
