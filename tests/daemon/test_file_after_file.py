"""A long recording: one file after another, limited by the retention policy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.recording import recordings_folder
from robotctl.kernel.patterns import PatternKind
from robotctl.recording import RecorderOptions, read_info, read_messages
from robotctl.recording.format.journal import EntryKind, decode
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from tests.support.waiting import loop_until
from tests.support.world import PATIENT, World


@pytest.fixture(autouse=True)
def short_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make each chunk fill a file."""
    options = partial(RecorderOptions, split_bytes=1)
    monkeypatch.setattr(recordings_folder, "RecorderOptions", options)


def files_of(world: World) -> list[Path]:
    return sorted(world.recordings.glob("*/*.mcap"), key=number_of)


def number_of(path: Path) -> int:
    return int(path.stem.rpartition("_")[2])


async def test_each_file_begins_with_a_snapshot_and_can_be_decided_again(
    in_process: Callable[..., Any], world: World
) -> None:
    async with in_process(drive=PatternKind.CIRCLE) as daemon:
        await loop_until(lambda: len(files_of(world)) > 5)
        for _ in range(3):
            await daemon.ask("record_split")
    seqs = []
    for path in files_of(world):
        entries = [decode(m.data) for m in read_messages(path, {"/robotctl/journal"})]
        assert entries[0].kind is EntryKind.SNAPSHOT
        seqs += [entry.seq for entry in entries]
        report = check_recording(path)
        assert report.verdict is Verdict.SAME
        assert not any("before the first snapshot" in note for note in report.notes)
    assert seqs == list(range(len(seqs)))


async def test_the_oldest_files_of_the_recording_that_goes_on_are_removed_as_well(
    in_process: Callable[..., Any], world: World, tmp_path: Path
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(f"{PATIENT}recording: {{max_total_gb: 0.0001}}\n")
    async with in_process(config=config):
        await loop_until(lambda: min(map(number_of, files_of(world)), default=0) >= 3)
    files = files_of(world)
    assert list(map(number_of, files)) == list(range(number_of(files[0]), number_of(files[-1]) + 1))
    assert read_info(files[0].parent).missing == ()
