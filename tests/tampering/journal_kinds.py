"""Edits of the journal and of the metadata that a check finds."""

from __future__ import annotations

from collections.abc import Mapping

from tests.support.heard_drives import JOURNAL
from tests.tampering.edits import (
    Kind,
    dropped,
    journal,
    metadata,
    removed,
    repeated,
    rewritten,
    without,
)
from tests.tampering.journal_changes import (
    decided_without_event,
    first_part_dropped,
    first_snapshot_dropped,
    later,
    rare_dropped,
    two_swapped,
)
from tests.tampering.stretches import stretch_removed

_LIMITS = r'"linear_mps":[0-9.]+'

IN_JOURNAL: Mapping[str, Kind] = {
    "journal: an entry dropped": dropped(JOURNAL),
    "journal: an entry repeated": repeated(JOURNAL),
    "journal: two entries swapped": journal(two_swapped),
    "journal: two entries swapped, chained anew": journal(two_swapped, careful=True),
    "journal: an event one ns later": journal(later),
    "journal: the first snapshot dropped": journal(first_snapshot_dropped),
    "journal: the first snapshot dropped, chained anew": journal(
        first_snapshot_dropped, careful=True
    ),
    "journal: all before a later snapshot dropped, chained anew": journal(
        first_part_dropped, careful=True
    ),
    "journal: an event of rare kind dropped": journal(rare_dropped),
    "journal: an event of rare kind dropped, chained anew": journal(rare_dropped, careful=True),
    "journal: a tick dropped": journal(without("Tick")),
    "journal: odometry dropped": journal(without("OdomReceived")),
    "journal: a battery level dropped": journal(without("BatteryReceived")),
    "journal: a request dropped, chained anew": journal(without("ModeRequested"), careful=True),
    "journal: the drive dropped, chained anew": journal(without("DriveRequested"), careful=True),
    "journal: an effect dropped, chained anew": decided_without_event,
    "journal: odometry changed, chained anew": journal(
        rewritten("OdomReceived", r'"x":([-0-9.e]+)', r'"x":1.5'), careful=True
    ),
    "journal: a battery level changed, chained anew": journal(
        rewritten("BatteryReceived", r'"level":[0-9.]+', '"level":0.77'), careful=True
    ),
    "journal: a command changed, chained anew": journal(
        rewritten("PublishTwist", r'"linear":0\.', '"linear":0.1'), careful=True
    ),
    "journal: a reason changed, chained anew": journal(
        rewritten("ModeChanged", r'"reason":"', '"reason":"not '), careful=True
    ),
    "journal: the source of a request changed": journal(
        rewritten("DriveRequested", r'"source":"operator"', '"source":"nobody"')
    ),
    "journal: a limit changed in one snapshot, chained anew": journal(
        rewritten("Snapshot", _LIMITS, '"linear_mps":0.59'), careful=True
    ),
    "journal: a limit changed in all snapshots, chained anew": journal(
        rewritten("Snapshot", _LIMITS, '"linear_mps":0.59', everywhere=True), careful=True
    ),
    "journal: the number of commands changed in all snapshots, chained anew": journal(
        rewritten("Snapshot", r'"commands":[0-9]+', '"commands":7', everywhere=True), careful=True
    ),
    "journal: topic removed": removed(JOURNAL),
    "all topics: a stretch of standing removed, all numbered and chained anew": stretch_removed(
        1.3, 1.6
    ),
    "metadata: the limit of the velocity changed": metadata(
        "robotctl", "parameter.limits.linear_mps", "0.59"
    ),
    "metadata: the topic of the commands changed": metadata(
        "robotctl", "parameter.command.topic", "other"
    ),
    "metadata: the topic of odometry changed": metadata(
        "robotctl", "parameter.odometry.topic", "other"
    ),
}
