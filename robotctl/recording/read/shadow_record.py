"""What a recording tells of a shadow: a kernel that decided beside the driving one."""

from __future__ import annotations

from collections.abc import Callable

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.journal import SHADOW_TOPIC, TOPIC, EntryKind, JournalEntry
from robotctl.recording.format.metadata_names import PARAMETER_PREFIX, SHADOW_RECORD
from robotctl.recording.read.info import RecordingInfo
from robotctl.recording.read.journal_reader import EntryDecoder, own_journal_topic
from robotctl.recording.read.reader import Recording

MAX_CHARACTERS = 200
"""Limit on the parameters in a sentence: metadata may hold any number."""

NEAR_NS = NS_PER_S
"""How far from its event an entry is searched."""


def shadow_topic(info: RecordingInfo) -> str | None:
    """Return the topic with the record of the shadow, None if no shadow is recorded."""
    topic = f"{own_journal_topic(info).removesuffix(TOPIC)}{SHADOW_TOPIC}"
    return topic if any(each.name == topic for each in info.topics) else None


def shadow_sentence(info: RecordingInfo) -> str:
    """Return with which parameters a shadow decided, "" if none is recorded."""
    topic = shadow_topic(info)
    if topic is None:
        return ""
    told = info.metadata.get(SHADOW_RECORD)
    if told is None:
        return f"a shadow decided with other parameters; where it differs is in {topic}"
    own = [
        f"{key.removeprefix(PARAMETER_PREFIX)} {value}"
        for key, value in told.items()
        if key.startswith(PARAMETER_PREFIX)
    ]
    parameters = ", ".join(own)[:MAX_CHARACTERS] or "the same parameters"
    return f"a shadow decided with {parameters}; where it differs is in {topic}"


def shadow_entries(
    recording: Recording, seq: int, log_ns: int, on_missing: Callable[[str], None]
) -> list[JournalEntry] | None:
    """Return what the shadow decided differently on event `seq` of the journal.

    `log_ns` is when the event was recorded, since the epoch. None if no shadow is recorded.

    Raises:
        UnreadableFile: An entry is damaged.
    """
    topic = shadow_topic(recording.info())
    if topic is None:
        return None
    decoder = EntryDecoder(recording)
    window = (max(log_ns - NEAR_NS, 0), log_ns + NEAR_NS)
    entries = [
        decoder.decode(each.data) for each in recording.messages({topic}, on_missing, window)
    ]
    return [entry for entry in entries if entry.seq == seq and entry.kind is EntryKind.EFFECT]
