"""A `metadata.yaml` that cannot be read is no missing one: the readers say it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robotctl.recording.read.reader import read_info
from robotctl.recording.read.whole_recording import verify_recording
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.testing.drives import drive, record


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("made") / "robot_20260101_120000", drive(2.0))


@pytest.mark.parametrize("kind", ["a folder", "a pipe", "no text", "too long"])
def test_a_metadata_file_that_cannot_be_read_is_told(made: Path, kind: str) -> None:
    path = made / "metadata.yaml"
    if path.is_dir():
        path.rmdir()
    path.unlink(missing_ok=True)
    match kind:
        case "a folder":
            path.mkdir()
        case "a pipe":
            os.mkfifo(path)
        case "no text":
            path.write_bytes(b"\xff\xfe\xfd")
        case "too long":
            path.write_text("a" * ((4 << 20) + 1))
    (said,) = read_info(made).missing
    assert said.startswith("metadata.yaml cannot be read: ")
    report = check_recording(made)
    assert report.verdict is Verdict.INCOMPLETE
    assert said in report.missing
    assert said in verify_recording(made).whole.unreadable
