"""A journal whose measurements were put into another order is found, whatever they decide."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random

import pytest

from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import heard_drive
from tests.tampering.edits import journal


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return heard_drive(tmp_path_factory.mktemp("heard") / "run", 3.0, requests=[])


def with_battery_moved(heard: Contents, by: int) -> Contents:
    """Return the contents with a battery level that many events of odometry later."""

    def change(entries: list[JournalEntry], random: Random) -> Sequence[JournalEntry | None]:
        at = [at for at, each in enumerate(entries) if each.name == "BatteryReceived"][1]
        odometry = [n for n in range(at, len(entries)) if entries[n].name == "OdomReceived"]
        to = odometry[by]
        return [*entries[:at], *entries[at + 1 : to + 1], entries[at], *entries[to + 1 :]]

    return journal(change, careful=True)(heard, Random(1))


def check(tmp_path: Path, contents: Contents) -> Report:
    return check_recording(write_contents(tmp_path / "run", contents))


def test_measurements_in_their_order_are_the_same(tmp_path: Path, heard: Contents) -> None:
    assert check(tmp_path, heard).verdict is Verdict.SAME


def test_a_measurement_that_was_moved_is_found(tmp_path: Path, heard: Contents) -> None:
    report = check(tmp_path, with_battery_moved(heard, 3))
    assert report.verdict is Verdict.BROKEN
    assert report.violations[0].text.startswith("1 measurements are earlier than one before them")
