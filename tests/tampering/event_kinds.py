"""Edits of the events that the metadata of a recording holds in addition to the journal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from random import Random

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.names import EVENT_RECORD, EventKind
from tests.support.edited_recordings import Contents
from tests.tampering.edits import Kind

Values = dict[str, str]


def every(values: Values) -> bool:
    """Accept any event."""
    return True


def of_drives(values: Values) -> bool:
    """Accept a drive that ended."""
    return values["kind"] == EventKind.DRIVE_ENDED.value


def one_event(
    change: Callable[[Values], Values | None], wanted: Callable[[Values], bool] = every
) -> Kind:
    """Change one of the events that are wanted; None removes it."""

    def make(contents: Contents, random: Random) -> Contents:
        edited = contents.copy()
        chosen = random.choice(
            [
                at
                for at, (name, values) in enumerate(contents.metadata)
                if name == EVENT_RECORD and wanted(values)
            ]
        )
        name, values = edited.metadata.pop(chosen)
        changed = change(values)
        if changed is not None:
            edited.metadata.insert(chosen, (name, changed))
        return edited

    return make


def no_events(contents: Contents, random: Random) -> Contents:
    """Remove all events."""
    edited = contents.copy()
    edited.metadata = [each for each in edited.metadata if each[0] != EVENT_RECORD]
    return edited


def another_drive(contents: Contents, random: Random) -> Contents:
    """Add a drive that ended well, after another event."""
    edited = contents.copy()
    places = [at for at, (name, _) in enumerate(edited.metadata) if name == EVENT_RECORD]
    at = random.choice(places)
    values = {
        "kind": EventKind.DRIVE_ENDED.value,
        "log_ns": edited.metadata[at][1]["log_ns"],
        "text": "drive finished: 99 laps",
        "laps": "99",
        "cross_track_max_m": "0.001",
    }
    edited.metadata.insert(at + 1, (EVENT_RECORD, values))
    return edited


def a_minute_later(values: Values) -> Values:
    """Move an event."""
    return {**values, "log_ns": str(int(values["log_ns"]) + 60 * NS_PER_S)}


FORGED_EVENTS: Mapping[str, Kind] = {
    "events: one removed": one_event(lambda values: None),
    "events: all removed": no_events,
    "events: a drive added": another_drive,
    "events: another text": one_event(lambda values: {**values, "text": "nothing happened"}),
    "events: a mark in the place of one": one_event(
        lambda values: {**values, "kind": EventKind.MARK.value}
    ),
    "events: a minute later": one_event(a_minute_later),
    "events: other laps": one_event(lambda values: {**values, "laps": "297"}, of_drives),
    "events: another error": one_event(
        lambda values: {**values, "cross_track_max_m": "0.0001"}, of_drives
    ),
    "events: a duration removed": one_event(
        lambda values: {name: each for name, each in values.items() if name != "drive_s"},
        of_drives,
    ),
}
"""Edits that only the seal shows."""
