"""Edits of the recorded topics that a check finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from robotctl.kernel.modes import Mode
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.heard_drives import COMMANDS, ESTOP, SET_MODE, STATUS, received
from tests.tampering.edits import (
    MOTION,
    Kind,
    added,
    all_changed,
    anywhere,
    by_one_ulp,
    changed,
    dropped,
    dropped_and_renumbered,
    journal,
    last_second_dropped,
    moves,
    removed,
    renamed,
    repeated,
    rewritten,
    still,
    swapped,
)
from tests.tampering.message_changes import (
    early,
    granted,
    late,
    level,
    mode,
    moved,
    not_first,
    not_last,
    numbered,
    requested,
    robot,
    shown_level,
    with_mode,
)
from tests.tampering.schema_kinds import IN_SCHEMAS

IN_TOPICS: Mapping[str, Kind] = {
    **IN_SCHEMAS,
    "commands: one that moves dropped": dropped(COMMANDS, 1, moves),
    "commands: any dropped": dropped(COMMANDS),
    "commands: many dropped": dropped(COMMANDS, 30, moves),
    "commands: one dropped, the others renumbered": dropped_and_renumbered(COMMANDS, moves),
    "commands: one changed by an ulp": changed(COMMANDS, by_one_ulp, moves),
    "commands: one that moves set to zero": changed(COMMANDS, lambda m, _: still(m), moves),
    "commands: one zero changed by an ulp": changed(
        COMMANDS, by_one_ulp, lambda each: not moves(each)
    ),
    "commands: one repeated": repeated(COMMANDS),
    "commands: two swapped": swapped(COMMANDS, moves),
    "commands: one with another number": changed(COMMANDS, numbered, moves),
    "commands: one sent late": changed(COMMANDS, lambda m, _: late(m), anywhere),
    "commands: one sent early": changed(COMMANDS, lambda m, _: early(m), anywhere),
    "commands: all sent late": all_changed(COMMANDS, late),
    "commands: all set to zero": all_changed(COMMANDS, still),
    "commands: all that move removed": all_changed(COMMANDS, lambda m: None if moves(m) else m),
    "commands: all removed": all_changed(COMMANDS, lambda m: None),
    "commands: topic removed": removed(COMMANDS),
    "commands: topic renamed": renamed(COMMANDS),
    "commands: motion added": added(COMMANDS, MOTION),
    "odometry: one dropped": dropped(ODOMETRY, 1, not_first),
    "odometry: many dropped": dropped(ODOMETRY, 100, not_first),
    "odometry: those of the last second dropped": last_second_dropped(ODOMETRY),
    "odometry: one dropped, the others renumbered": dropped_and_renumbered(ODOMETRY, not_last),
    "odometry: one moved": changed(ODOMETRY, moved, anywhere),
    "odometry: two swapped": swapped(ODOMETRY, anywhere),
    "odometry: one repeated": repeated(ODOMETRY),
    "odometry: one with another number": changed(ODOMETRY, numbered, anywhere),
    "odometry: all removed": all_changed(ODOMETRY, lambda m: None),
    "odometry: topic renamed": renamed(ODOMETRY),
    "odometry: topic removed": removed(ODOMETRY),
    "battery: one dropped": dropped(BATTERY, 1, not_first),
    "battery: one changed": changed(BATTERY, level, anywhere),
    "battery: one repeated": repeated(BATTERY),
    "battery: topic removed": removed(BATTERY),
    "status: another mode": changed(STATUS, mode, lambda m: m.sequence == 2),
    "status: another robot": changed(STATUS, robot, anywhere),
    "status: topic removed": removed(STATUS),
    "status: topic renamed": renamed(STATUS),
    "service: a call for another mode": changed(SET_MODE, requested, lambda m: m.sequence == 1),
    "service: a response says the opposite": changed(SET_MODE, granted, lambda m: m.sequence == 2),
    "service: a call received late": changed(
        ESTOP, lambda m, _: late(m), lambda m: m.sequence == 1
    ),
    "service: a call added": added(ESTOP, received(9, None)),
    "service: a request added to the journal, chained anew": journal(
        rewritten("ModeRequested", '"the ROS service /estop"', '"the ROS service /set_mode"'),
        careful=True,
    ),
}

FORGED_STATUSES: Mapping[str, Kind] = {
    "status: another battery level": changed(STATUS, shown_level, lambda m: m.sequence > 3),
    "status: the mode before at a change": changed(
        STATUS, lambda m, _: with_mode(m, Mode.IDLE), lambda m: m.sequence == 2
    ),
    "status: the mode of the next change": changed(
        STATUS, lambda m, _: with_mode(m, Mode.IDLE), lambda m: m.sequence in (3, 4)
    ),
    "status: one says that odometry was stale": changed(
        STATUS, lambda m, _: replace(m, data=m.data[:-1] + b"\0"), lambda m: m.sequence > 2
    ),
    "status: two swapped": swapped(STATUS, anywhere),
    "status: one shown late": changed(STATUS, lambda m, _: late(m), lambda m: m.sequence == 2),
}
"""Edits that only the seal shows."""
