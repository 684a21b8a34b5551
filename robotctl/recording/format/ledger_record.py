"""The loss ledger as a file keeps it: a JSON object per topic."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping

from robotctl.recording.format.identity import LEDGER_RECORD
from robotctl.recording.format.topics import TopicStats

_COUNTS = ("received", "written", "queued", "dropped", "lost", "unseen", "bytes", "not_repeated")


def ledger_values(topics: Iterable[TopicStats]) -> dict[str, str]:
    """The ledger as the values of a metadata record."""
    totals: dict[tuple[str, str], Counter[str]] = {}
    for stats in topics:
        counts = totals.setdefault((stats.name, stats.type_name), Counter())
        counts.update({count: getattr(stats, count) for count in _COUNTS})
    ledger: dict[str, str] = {}
    for (topic, type_name), counts in totals.items():
        # A topic is recorded with a second type where a node publishes one.
        name = f"{topic} ({type_name})" if topic in ledger else topic
        ledger[name] = json.dumps(counts)
    return ledger


def read_ledger(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, int]]:
    """The counts of each topic; of a file that was not closed there are none."""
    ledger = {}
    for topic, text in metadata.get(LEDGER_RECORD, {}).items():
        try:
            counts = json.loads(text)
            ledger[topic] = {count: int(counts[count]) for count in _COUNTS if count in counts}
        except (ValueError, TypeError, OverflowError, RecursionError):  # not ours
            continue
    return ledger
