"""The report of `robotctl evidence`: software, configuration, changes, interventions and stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from robotctl.decisions.journal import DecisionKind, Entry

STANDING: Final = ("ERROR", "EMERGENCY_STOP")
"""The modes that count as stops."""

ENDED: Final = "in order"
KILLED: Final = "killed, or the power was cut"
RUNS: Final = "it runs"
"""Values of `ended` in `Evidence.daemons`; for a daemon that failed, `ended` is its error."""


@dataclass(slots=True)
class Evidence:
    """The history of one robot; `evidence --json` prints each field under the field's name.

    `software` and `configuration` are those of the last start. Each item of a list has `time_ns`
    since the epoch, and the `recording` of the daemon that ran then, "" if it made none.
    """

    software: Mapping[str, Any] = field(default_factory=dict)
    software_changes: list[dict[str, Any]] = field(default_factory=list)
    configuration: Mapping[str, Any] = field(default_factory=dict)
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
    """Return the evidence in `entries` from `since_ns` (since the epoch) on.

    Daemons that ended earlier are left out. The last daemon counts as running if it has no END
    entry.
    """
    found = Evidence()
    daemon: dict[str, Any] = {}
    for entry in entries:
        values = dict(entry.values)
        if entry.kind == DecisionKind.START:
            if daemon and daemon["end_ns"] is None:
                daemon |= {"ended": KILLED, "end_ns": daemon["last_ns"]}
            daemon = {"recording": "", **values, "time_ns": entry.time_ns}
            daemon |= {"last_ns": entry.time_ns, "end_ns": None, "ended": RUNS}
            found.daemons.append(daemon)
            continue
        if daemon:
            daemon["last_ns"] = entry.time_ns
        match entry.kind:
            case DecisionKind.END if daemon:
                daemon |= {"end_ns": entry.time_ns, "ended": values.get("failure", ENDED)}
            case DecisionKind.SOFTWARE:
                before, found.software = found.software, values
                values = _change(before, values, daemon)
            case DecisionKind.CONFIGURATION:
                before, found.configuration = found.configuration, values
                values = _change(before, values, daemon)
            case DecisionKind.PARAMETER:
                changed = {str(values.get("key")): [values.get("from"), values.get("to")]}
                values |= {"changed": changed, "first": False}
        place = _place(found, entry)
        if place is not None and entry.time_ns >= since_ns:
            recording = daemon.get("recording", "")
            place.append({"time_ns": entry.time_ns, **values, "recording": recording})
    found.daemons = [
        each for each in found.daemons if each["end_ns"] is None or each["end_ns"] >= since_ns
    ]
    return found


def _place(found: Evidence, entry: Entry) -> list[dict[str, Any]] | None:
    """Return the list of `found` for an entry, None if there is none."""
    if entry.kind == DecisionKind.MODE and entry.values.get("to") in STANDING:
        return found.stops
    if entry.kind == DecisionKind.MODE and entry.values.get("from") in STANDING:
        return found.releases
    lists: dict[str, list[dict[str, Any]]] = {
        DecisionKind.SOFTWARE: found.software_changes,
        DecisionKind.CONFIGURATION: found.configuration_changes,
        DecisionKind.PARAMETER: found.configuration_changes,
        DecisionKind.REQUEST: found.interventions,
        DecisionKind.REFUSED: found.refusals,
        DecisionKind.REMOVED: found.removed,
        DecisionKind.MORE: found.unwritten,
    }
    return lists.get(entry.kind)


def _change(
    before: Mapping[str, Any], after: Mapping[str, Any], daemon: Mapping[str, Any]
) -> dict[str, Any]:
    """Return `by`, `first` (no value before) and `changed` (key -> [old, new])."""
    keys = [*before, *(key for key in after if key not in before)] if before else []
    changed = {
        key: [before.get(key), after.get(key)] for key in keys if before.get(key) != after.get(key)
    }
    return {"by": daemon.get("by", ""), "first": not before, "changed": changed}
