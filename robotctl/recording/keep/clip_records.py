"""The metadata that a clip takes over from its recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from mcap.records import Metadata

from robotctl.recording.format.names import (
    CLIP_RECORD,
    EVENT_RECORD,
    FOXGLOVE_RECORD,
    INFO_RECORD,
    LEDGER_RECORD,
    RECOVERY_RECORD,
    SOFTWARE_RECORD,
)
from robotctl.recording.format.recorded_events import events_in
from robotctl.recording.format.rosbag2 import METADATA_RECORD
from robotctl.recording.read.messages import Window

_OF_THE_WHOLE = (METADATA_RECORD, LEDGER_RECORD, RECOVERY_RECORD, EVENT_RECORD, CLIP_RECORD)
"""Metadata that is not true for a part of the recording."""

_OF_EACH_FILE = (INFO_RECORD, SOFTWARE_RECORD, FOXGLOVE_RECORD)
"""Metadata that each file of the recording repeats."""


def records_of_clip(
    recorded: Iterable[Metadata], window: Window
) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield name and values of each record that a clip of `window` holds, beside its own.

    What made the recording is there once, without the mode, which is that of its start.
    """
    records = list(recorded)
    for record in records:
        if record.name not in (*_OF_THE_WHOLE, *_OF_EACH_FILE):
            yield record.name, record.metadata
    last = {record.name: record.metadata for record in records}
    for name in _OF_EACH_FILE:
        if name in last:
            yield name, {key: value for key, value in last[name].items() if key != "mode"}
    for event in events_in(records):
        if window[0] <= event.log_ns <= window[1]:
            yield EVENT_RECORD, event.values()
