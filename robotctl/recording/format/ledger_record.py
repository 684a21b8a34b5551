"""The loss ledger as a file stores it: a JSON object per topic."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

from robotctl.recording.format.message_counts import COUNTERS
from robotctl.recording.format.metadata_names import LEDGER_RECORD
from robotctl.recording.format.topics import TopicStats, by_topic

_COUNTS = (*COUNTERS, "bytes")


def ledger_values(topics: Iterable[TopicStats]) -> dict[str, str]:
    """Return the ledger as the values of a metadata record."""
    ledger: dict[str, str] = {}
    for stats in by_topic(topics):
        # A topic has a second type if a node publishes one.
        name = f"{stats.name} ({stats.type_name})" if stats.name in ledger else stats.name
        ledger[name] = json.dumps({count: getattr(stats, count) for count in _COUNTS})
    return ledger


def read_ledger(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, int]]:
    """Return the counts of each topic; empty for a file that was not closed."""
    ledger = {}
    for topic, text in metadata.get(LEDGER_RECORD, {}).items():
        try:
            counts = json.loads(text)
            ledger[topic] = {count: int(counts[count]) for count in _COUNTS if count in counts}
        except (ValueError, TypeError, OverflowError, RecursionError):  # not written by robotctl
            continue
    return ledger
