"""Edits that add messages after the last ones of a topic, as if more had come."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from random import Random

from robotctl.kernel.modes import Mode
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.hearing import BATTERY, ODOMETRY, TOPICS
from tests.support.edited_recordings import Contents, Stored
from tests.support.heard_drives import COMMANDS, ESTOP, STATUS, received
from tests.tampering.edits import MOTION, Kind, still
from tests.tampering.message_changes import with_mode

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
