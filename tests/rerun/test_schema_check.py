"""A check tells where a topic has another type than the one whose fields it knows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import Written
from tests.support.edited_recordings import Contents, recorded, write_contents

OTHER_HASH = f"RIHS01_{0:064}"
ANOTHER = "/odom is recorded with another version of nav_msgs/msg/Odometry than the check reads"


@pytest.fixture
def honest(tmp_path: Path, drive_of_3_s: list[Written]) -> Contents:
    return recorded(tmp_path / "honest", drive_of_3_s)


def checked_with(folder: Path, contents: Contents, type_hash: str) -> Report:
    """Check a recording that describes its odometry a second time, with this hash."""
    channel, schema = next(each for each in contents.types if each[0].topic == "/odom")
    metadata = {**channel.metadata, "topic_type_hash": type_hash}
    twice = contents.copy()
    twice.types = [(replace(channel, metadata=metadata), schema), *contents.types]
    return check_recording(write_contents(folder / "run", twice))


def test_another_version_of_a_type_that_the_check_reads_is_missed(
    tmp_path: Path, honest: Contents
) -> None:
    report = checked_with(tmp_path, honest, OTHER_HASH)
    assert (report.verdict, report.missing) == (Verdict.INCOMPLETE, [ANOTHER])


def test_a_type_whose_version_is_not_told_is_missed(tmp_path: Path, honest: Contents) -> None:
    report = checked_with(tmp_path, honest, "")
    assert report.verdict is Verdict.INCOMPLETE
    assert report.missing == ["/odom is recorded without the definition of its type"]
