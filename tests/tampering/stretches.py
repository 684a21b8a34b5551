"""The most careful forger: a stretch is removed from all topics, and all is numbered anew."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from random import Random

from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, decode, encode
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, Stored
from tests.support.heard_drives import COMMANDS, JOURNAL
from tests.tampering.edits import Kind

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
