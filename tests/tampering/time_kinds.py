"""Edits of the times at which messages were recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from random import Random

from robotctl.kernel.modes import Mode
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, Stored, edit
from tests.support.heard_drives import COMMANDS, JOURNAL, STATUS
from tests.tampering.edits import Kind, anywhere, changed
from tests.tampering.message_changes import with_mode

HOUR_S = 3600.0


def recorded_later(message: Stored, by_s: float) -> Stored:
    """Move the time at which a message was recorded."""
    return replace(message, log_ns=message.log_ns + round(by_s * NS_PER_S))


def all_later(by_s: Callable[[int], float], *topics: str) -> Kind:
    """Move the times of all messages of one of these topics, each by its position."""

    def make(contents: Contents, random: Random) -> Contents:
        chosen = random.choice(topics)
        return edit(contents, chosen, lambda at, each: recorded_later(each, by_s(at)))

    return make


def another_ahead(contents: Contents, random: Random) -> Contents:
    """Add a status of another mode, recorded before the one with its number was sent."""
    places = [at for at, each in enumerate(contents.messages) if each.topic == STATUS]
    at = random.choice(places)
    real = contents.messages[at]
    mode = random.choice([each for each in Mode if with_mode(real, each) != real])
    edited = contents.copy()
    early = replace(with_mode(real, mode), log_ns=real.publish_ns - 1)
    edited.messages.insert(at, early)
    return edited


OTHERS = (COMMANDS, ODOMETRY, BATTERY, STATUS)

FORGED_TIMES: Mapping[str, Kind] = {
    "journal: each second entry recorded later": all_later(lambda at: at % 2 * 0.3, JOURNAL),
    "journal: some entries recorded later": all_later(lambda at: at // 50 % 2 * 0.3, JOURNAL),
    "journal: recorded ever later": all_later(float, JOURNAL),
    "journal: one entry recorded an hour later": changed(
        JOURNAL, lambda each, _: recorded_later(each, HOUR_S), lambda each: each.sequence < 400
    ),
    "journal: one of its first entries recorded an hour later": changed(
        JOURNAL, lambda each, _: recorded_later(each, HOUR_S), lambda each: each.sequence < 4
    ),
    "a topic: recorded an hour later": all_later(lambda at: HOUR_S, *OTHERS),
    "a topic: recorded an hour earlier": all_later(lambda at: -HOUR_S, *OTHERS),
    "status: another one recorded before it was sent": another_ahead,
    "odometry: one recorded a minute earlier": changed(
        ODOMETRY, lambda each, _: recorded_later(each, -60.0), anywhere
    ),
}
"""Edits that only the seal shows."""
