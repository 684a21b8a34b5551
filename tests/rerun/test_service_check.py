"""What is held against the recorded calls of a service."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.recording.format.metadata_names import LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.testing.drives import BEGIN_NS, drive_requested
from tests.support.edited_recordings import Stored, write_contents
from tests.support.heard_drives import heard_drive
from tests.support.service_calls import SET_MODE, received


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
