"""The report of `robotctl evidence`: software, configuration, changes, interventions and stops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from robotctl.decisions.journal import DecisionKind, Entry

STANDING: Final = ("ERROR", "EMERGENCY_STOP")
"""The modes that count as stops."""

ENDED: Final = "in order"
KILLED: Final = "killed, or the power was cut"
RUNS: Final = "it runs"
"""These are the values of a daemon's `ended`, unless it failed: then the error is the value."""


@dataclass(slots=True)
class Evidence:
    """What happened to one robot; each item is an object of `evidence --json`.

    `software` and `configuration` are those of the last start. Each item of a list has `time_ns`
    since the epoch, and the `recording` that its daemon made, "" if there is none.
    """

    software: Mapping[str, Any] = field(default_factory=dict)
    configuration: Mapping[str, Any] = field(default_factory=dict)
    software_changes: list[dict[str, Any]] = field(default_factory=list)
    configuration_changes: list[dict[str, Any]] = field(default_factory=list)
    daemons: list[dict[str, Any]] = field(default_factory=list)
    interventions: list[dict[str, Any]] = field(default_factory=list)
    stops: list[dict[str, Any]] = field(default_factory=list)
    releases: list[dict[str, Any]] = field(default_factory=list)
    refusals: list[dict[str, Any]] = field(default_factory=list)
    removed: list[dict[str, Any]] = field(default_factory=list)
    unwritten: list[dict[str, Any]] = field(default_factory=list)

    def recordings(self) -> list[str]:
        """Return the recordings that the daemons made, in chronological order, each once."""
        return list(dict.fromkeys(each["recording"] for each in self.daemons if each["recording"]))


def collect(entries: Sequence[Entry], since_ns: int = 0) -> Evidence:
    """Return what happened since `since_ns`, with software and configuration of the last start.

    A daemon that started before `since_ns` is included unless it ended before. If the last daemon
    has no END entry, it counts as running: the entries cannot show whether it was killed.
    """
    collector = _Collector(since_ns)
    for entry in entries:
        collector.take(entry)
    return collector.finish()


class _Collector:
    def __init__(self, since_ns: int) -> None:
        self._since_ns = since_ns
        self._found = Evidence()
        self._daemon: dict[str, Any] | None = None

    def take(self, entry: Entry) -> None:
        """Add an entry to the report."""
        if self._daemon is not None and entry.kind != DecisionKind.START:
            self._daemon["last_ns"] = entry.time_ns
        if entry.kind == DecisionKind.START:
            self._begin(entry)
        elif entry.kind == DecisionKind.END and self._daemon is not None:
            self._daemon["end_ns"] = entry.time_ns
            self._daemon["ended"] = entry.values.get("failure", ENDED)
        elif entry.kind == DecisionKind.SOFTWARE:
            self._identity(entry, self._found.software, self._found.software_changes)
            self._found.software = entry.values
        elif entry.kind == DecisionKind.CONFIGURATION:
            self._identity(entry, self._found.configuration, self._found.configuration_changes)
            self._found.configuration = entry.values
        elif entry.time_ns >= self._since_ns:
            for place in self._places_of(entry):
                place.append(self._item(entry, entry.values))

    def finish(self) -> Evidence:
        """Return the report, after removing the daemons that ended before `since_ns`."""
        self._found.daemons = [
            each
            for each in self._found.daemons
            if each["end_ns"] is None or each["end_ns"] >= self._since_ns
        ]
        return self._found

    def _begin(self, entry: Entry) -> None:
        if self._daemon is not None and self._daemon["end_ns"] is None:
            self._daemon["ended"] = KILLED
            self._daemon["end_ns"] = self._daemon["last_ns"]
        self._daemon = {
            "recording": "",
            **entry.values,
            "time_ns": entry.time_ns,
            "last_ns": entry.time_ns,
            "end_ns": None,
            "ended": RUNS,
        }
        self._found.daemons.append(self._daemon)

    def _identity(
        self, entry: Entry, before: Mapping[str, Any], changes: list[dict[str, Any]]
    ) -> None:
        if entry.time_ns >= self._since_ns:
            by = "" if self._daemon is None else self._daemon.get("by", "")
            changed = difference(before, entry.values) if before else {}
            changes.append(self._item(entry, {"by": by, "first": not before, "changed": changed}))

    def _places_of(self, entry: Entry) -> Iterator[list[dict[str, Any]]]:
        found, values = self._found, entry.values
        match entry.kind:
            case DecisionKind.MODE:
                if values.get("to") in STANDING:
                    yield found.stops
                elif values.get("from") in STANDING:
                    yield found.releases
            case DecisionKind.REQUEST:
                yield found.interventions
            case DecisionKind.REFUSED:
                yield found.refusals
            case DecisionKind.PARAMETER:
                yield found.configuration_changes
            case DecisionKind.REMOVED:
                yield found.removed
            case DecisionKind.MORE:
                yield found.unwritten

    def _item(self, entry: Entry, values: Mapping[str, Any]) -> dict[str, Any]:
        recording = "" if self._daemon is None else self._daemon["recording"]
        changed = {}
        if entry.kind == DecisionKind.PARAMETER:
            key = str(values.get("key"))
            changed = {"changed": {key: [values.get("from"), values.get("to")]}, "first": False}
        return {"time_ns": entry.time_ns, **values, **changed, "recording": recording}


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return `[old, new]` for each key whose value differs; the value of a missing key is None."""
    keys = [*before, *(key for key in after if key not in before)]
    return {
        key: [before.get(key), after.get(key)] for key in keys if before.get(key) != after.get(key)
    }
