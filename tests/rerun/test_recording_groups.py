"""A folder with files of several recordings: each is checked on its own, and named."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.recording_groups import file_groups
from robotctl.testing.drives import Written, drive, record


@pytest.mark.parametrize("robot", ["robot", "r2"])
def test_a_file_of_another_recording_is_named_and_checked_on_its_own(
    tmp_path: Path, drive_of_3_s: list[Written], robot: str
) -> None:
    folder = record(tmp_path / "run", drive_of_3_s)
    (other,) = record(tmp_path / "other", drive(1.0), robot=robot).glob("*.mcap")
    shutil.copy(other, folder)
    report = check_recording(folder)
    assert report.verdict is Verdict.INCOMPLETE
    assert (
        f"{other.name} is of another recording, of robot {robot}: checked on its own, it is same"
        in report.missing
    )
    assert report.events == check_recording(folder / "run_0.mcap").events


def test_the_files_of_one_recording_are_one_group(
    tmp_path: Path, drive_of_3_s: list[Written]
) -> None:
    folder = record(tmp_path / "run", drive_of_3_s)
    (tmp_path / "run" / "run_1.mcap").write_bytes(b"damaged")
    (group,) = file_groups(folder)
    assert [file.name for file in group.files] == ["run_0.mcap", "run_1.mcap"]
