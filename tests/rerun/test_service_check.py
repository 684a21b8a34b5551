"""Each call of a service is one request in the journal; what is not is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ModeRequested, Reply
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.names import LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.service_check import MANY_IN_WORK, SERVICES, ServicePairs, read_service_event
from robotctl.testing.drives import BEGIN_NS, drive_requested
from tests.support.edited_recordings import Stored, write_contents
from tests.support.heard_drives import SET_MODE, heard_drive, received, sent


@pytest.mark.parametrize(
    ("before_end_s", "closed", "verdict"),
    [(0.0, True, Verdict.BROKEN), (0.0, False, Verdict.SAME), (1.0, False, Verdict.BROKEN)],
)
def test_a_call_at_the_end_may_have_its_request_after_it_unless_the_recording_was_closed(
    tmp_path: Path, before_end_s: float, closed: bool, verdict: Verdict
) -> None:
    contents = heard_drive(tmp_path / "heard", 2.0, requests=[drive_requested(BEGIN_NS)])
    if not closed:
        contents.metadata = [each for each in contents.metadata if each[0] != LEDGER_RECORD]
    at_ns = contents.messages[-1].log_ns - round(before_end_s * 1e9)
    contents.messages.append(Stored(SET_MODE, received(1, 2), at_ns, at_ns, 1))
    report = check_recording(write_contents(tmp_path / "run", contents))
    assert (report.verdict, report.missing) == (verdict, [])


WALL_NS = 1_700_000_000 * NS_PER_S
SOURCE = "the ROS service /set_mode"
BUSY = f"busy: {2 * MANY_IN_WORK} requests wait for their reply; try again"


class Traffic:
    """Calls of `set_mode` and their requests in the journal, one a second."""

    def __init__(self) -> None:
        self.pairs = ServicePairs(SOURCE, {})
        self.clock = ClockChanges()

    def call(self, number: int, requested: int, late_s: float = 0.0) -> None:
        now_ns = WALL_NS + number * NS_PER_S + round(late_s * NS_PER_S)
        event = read_service_event(SERVICES[0], received(number, requested), now_ns)
        assert event is not None
        self.pairs.event(event, now_ns)

    def response(self, number: int, ok: bool, text: str, mode: int) -> None:
        now_ns = WALL_NS + number * NS_PER_S
        event = read_service_event(SERVICES[0], sent(number, ok, text, mode), now_ns)
        assert event is not None
        self.pairs.event(event, now_ns)

    def ask(self, number: int, requested: int) -> None:
        t_ns = number * NS_PER_S
        moments = t_ns, WALL_NS + t_ns, WALL_NS + t_ns
        self.pairs.request(ModeRequested(t_ns, number, requested, SOURCE), number, moments)
        self.pairs.reply(Reply(number, True, "done", Mode(requested)))


@pytest.mark.parametrize(("in_work", "unasked"), [(0, 1), (MANY_IN_WORK + 1, 0)])
def test_a_call_is_refused_as_busy_only_while_many_are_in_work(in_work: int, unasked: int) -> None:
    traffic = Traffic()
    for number in range(in_work):
        traffic.call(number, 0)
        traffic.ask(number, 0)
    traffic.call(in_work, 1)
    traffic.response(in_work, False, BUSY, 0)
    traffic.pairs.pair(traffic.clock)
    assert len(traffic.pairs.unasked) == unasked
    assert len(traffic.pairs.pairs) == in_work
