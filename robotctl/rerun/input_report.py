"""Says what differs between the inputs in a journal and the recorded messages."""

from __future__ import annotations

from math import inf

from robotctl.rerun.check_report import Report
from robotctl.rerun.ending import Ending, JournalEnd
from robotctl.rerun.input_pairs import EDGE_NS, InputPairs
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.unheard_end import LOST, UnheardEnd


def report_inputs(
    report: Report,
    invariants: Invariants,
    name: str,
    pairs: InputPairs,
    ending: Ending,
    *,
    is_left_out: bool,
) -> None:
    """Report values that differ, missing and repeated messages of the input `name`.

    `pairs` have ended. `is_left_out` tells that the configuration leaves the topic out.
    """
    if pairs.differing:
        text = f"{pairs.differing} messages are not what the control loop received as"
        text = f"{text} {name}: {pairs.differing_example}"
        if pairs.has_one_publisher or pairs.differing > ending.lost:
            ending.accuse(report, invariants, text)
        else:
            report.notes.append(text)
    _report_lacking(report, invariants, name, pairs, ending, is_left_out=is_left_out)
    if pairs.repeated and pairs.has_one_publisher:
        report.miss(f"{pairs.repeated} messages of {name} are repeated or out of order")


def _report_lacking(
    report: Report,
    invariants: Invariants,
    name: str,
    pairs: InputPairs,
    ending: Ending,
    *,
    is_left_out: bool,
) -> None:
    count = pairs.lacking + (0 if ending.is_clip else pairs.before_first)
    if not (ending.is_clip or ending.has_begin) and pairs.at_begin:
        count -= pairs.at_begin
        report.notes.append(
            f"the first {pairs.at_begin} messages of {name} are not here: the file before has them"
        )
    elif ending.ledger is None and not ending.is_clip and pairs.before_found:
        count -= pairs.before_found
        report.notes.append(
            f"the first {pairs.before_found} messages of {name} are not recorded: the "
            "recorder finds a publisher later than the control loop"
        )
    if not count:
        return
    text = f"{count} messages of {name} that the control loop received are not recorded"
    if pairs.lacking_example:
        text += f", the first is of {pairs.lacking_example}"
    if count <= ending.lost:
        report.notes.append(f"{text}: {ending.lost} were counted as lost")
    elif is_left_out:
        report.notes.append(f"the topic of {name} was not recorded, as configured")
    elif ending.ledger is None:
        report.miss(f"{text}; {ending.unknown_losses}")
    else:
        ending.accuse(report, invariants, text)


def report_last(
    report: Report,
    name: str,
    pairs: InputPairs,
    ending: Ending,
    moment: JournalEnd,
    waited_ns: int,
    *,
    is_rare: bool = False,
) -> int:
    """Report messages after the last input that cannot all have been under way.

    The control loop may have been `waited_ns` late. If `is_rare` is set, most messages never become
    an input. Return how many messages may have been lost.
    """
    if not (pairs.paired and pairs.has_one_publisher and ending.is_own) or moment.clock_changed:
        return 0
    last = UnheardEnd(
        pairs.later_ns,
        moment.log_ns,
        EDGE_NS + waited_ns,
        pairs.rate_hz,
        inf if is_rare else pairs.unheard + LOST,
    )
    if difference := last.difference():
        report.miss(f"{name}: {difference}")
        return 0
    return last.earlier
