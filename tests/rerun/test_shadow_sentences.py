"""`why` tells what a shadow decided on the event, from its entries; they may hold anything."""

from __future__ import annotations

import pytest

from robotctl.kernel.codec import to_json
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ModeChanged, PublishTwist, Twist
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.shadow_sentences import shadow_words

SLOWER = PublishTwist(Twist(0.1, 0.0))
STOPPED = (PublishTwist(Twist(0.0, 0.0)), ModeChanged(Mode.MOVING, Mode.ERROR, "lost", None))


def entry(name: str, data: str = "{}") -> JournalEntry:
    return JournalEntry(7, 1, EntryKind.EFFECT, name, data)


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        (None, ""),
        ([], "no other decision of the shadow is recorded"),
        (
            [entry("PublishTwist", to_json(SLOWER))],
            "0.1 m/s, 0 rad/s instead of 0 m/s, 0 rad/s; ERROR: lost",
        ),
        ([entry("Nothing")], "nothing instead of 0 m/s, 0 rad/s; ERROR: lost"),
        ([entry("Failed", '{"failure":"slow"}')], "the shadow was switched off here"),
        ([entry("Dance")], "not read: journal entry 7 cannot be read: no effect is called 'Dance'"),
    ],
)
def test_each_kind_of_entry_is_told(entries: list[JournalEntry] | None, says: str) -> None:
    assert shadow_words(entries, STOPPED) == says
