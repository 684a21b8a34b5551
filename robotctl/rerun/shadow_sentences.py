"""What a shadow decided on an event, from its record, in words."""

from __future__ import annotations

from collections.abc import Sequence

from robotctl.errors import UnreadableFile
from robotctl.kernel.shadow import contrast
from robotctl.kernel.types import Effect
from robotctl.recording.format.journal import NO_EFFECT, SHADOW_FAILED, JournalEntry
from robotctl.rerun.journal_values import read_effect


def shadow_words(entries: Sequence[JournalEntry] | None, driving: Sequence[Effect]) -> str:
    """Return what the entries of one event tell, "" without a shadow (None).

    `driving` is what the driving kernel decided on the event.
    """
    if entries is None:
        return ""
    if not entries:
        return "no other decision of the shadow is recorded"
    if any(entry.name == SHADOW_FAILED for entry in entries):
        return "the shadow was switched off here"
    try:
        effects = [read_effect(each) for each in entries if each.name != NO_EFFECT]
    except UnreadableFile as error:
        return f"not read: {error}"
    instead_of, decided = contrast(driving, effects)
    return f"{decided} instead of {instead_of}"
