"""Reports how often the clock was set, and log times that no clock tells."""

from __future__ import annotations

from typing import Final

from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.log_order import LogOrder

MAX_SET: Final = 5
"""How often the clock may be set in a recording: a machine does so when it finds a time server."""

CHUNKS: Final = 4
"""How often log times may go back for each change of the clock: the messages that were recorded
around it stand in several chunks."""


def tell_times(clock: ClockChanges, order: LogOrder, report: Report) -> None:
    """Report how often the clock was set, and log times that no clock tells."""
    if clock.offset_ns is None:  # version 0.1.0
        return
    changes = clock.set_by_ns
    if order.steps_back > CHUNKS * len(changes):
        report.miss(
            f"log times go back {order.steps_back} times although the clock was not set then, "
            f"first at a message of {order.example}"
        )
    if not changes:
        return
    often = "once" if len(changes) == 1 else f"{len(changes)} times"
    text = (
        f"the clock was set {often}, first by {changes[0] / NS_PER_S:+.2f} s: times around it are "
        "not compared"
    )
    if clock.was_set_back or len(changes) > MAX_SET:
        report.miss(text)
    else:
        report.notes.append(text)
