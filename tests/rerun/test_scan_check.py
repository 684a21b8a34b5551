"""The sectors of each scan in the journal are those of the recorded scan."""

from __future__ import annotations

import struct
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from robotctl.config import Config
from robotctl.kernel.obstacles import ScanParams
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.types import Event, ScanReceived
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import BEGIN_NS, drive_requested
from robotctl.testing.hearing import SCAN
from tests.support.edited_recordings import Contents, Stored, edit, write_contents
from tests.support.heard_drives import heard_drive

RANGES_AT = 4 + 16 + 7 * 4 + 4
"""Where the ranges begin in a scan without a frame name."""

CLEAR = (inf,) * 63


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """A drive with ten scans a second, in which something comes nearer behind the robot."""
    params = replace(KernelParams(), scan=ScanParams(use=Use.OPTIONAL))
    scans = [
        ScanReceived(BEGIN_NS + 50_000_000 + number * 100_000_000, (9.0 - number / 10.0, *CLEAR))
        for number in range(50)
    ]
    requests: list[Event] = [*scans, drive_requested()]
    requests.sort(key=lambda event: event.t_ns)
    folder = tmp_path_factory.mktemp("scanned") / "run"
    return heard_drive(folder, 6.0, requests=requests, config=Config(kernel=params))


def check(tmp_path: Path, contents: Contents) -> Report:
    return check_recording(write_contents(tmp_path / "run", contents))


def test_the_recorded_scans_have_the_sectors_of_the_journal(
    tmp_path: Path, scanned: Contents
) -> None:
    report = check(tmp_path, scanned)
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])
    assert scanned.counts[SCAN] == 50


def test_a_scan_that_was_changed_is_found(tmp_path: Path, scanned: Contents) -> None:
    def nearer(at: int, each: Stored) -> Stored:
        data = bytearray(each.data)
        struct.pack_into("<f", data, RANGES_AT, 0.5)
        return replace(each, data=bytes(data)) if at == 20 else each

    report = check(tmp_path, edit(scanned, SCAN, nearer))
    assert report.verdict is Verdict.BROKEN
    assert "1 messages are not what the control loop received as the scan" in (
        report.violations[0].text
    )


def test_scans_that_were_removed_are_missed(tmp_path: Path, scanned: Contents) -> None:
    edited = edit(scanned, SCAN, lambda at, each: each if at not in (20, 21) else None)
    report = check(tmp_path, edited)
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith("2 messages of the scan")
