"""What lies beside the checked part of a recording excuses nothing in it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from robotctl.recording.format.journal import EntryKind, decode
from robotctl.recording.format.metadata_names import LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.recording_ends import SINGLE_FILE
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import COMMANDS, JOURNAL, heard_drive
from tests.tampering.edits import MOTION, changed, metadata, moves


def halves(contents: Contents, *, queued: int = 0) -> tuple[Contents, Contents]:
    """Return what two files hold.

    The ledger of the first one may count journal entries that were `queued` for the second.
    """
    at = [
        number
        for number, each in enumerate(contents.messages)
        if each.topic == JOURNAL and decode(each.data).kind is EntryKind.SNAPSHOT
    ][1]
    first, second = contents.copy(), contents.copy()
    first.messages, second.messages = contents.messages[:at], contents.messages[at:]
    second.counts = Counter(each.topic for each in second.messages)  # its ledger counts both files
    for name, values in first.metadata:
        if name == LEDGER_RECORD:
            counts = json.loads(values[JOURNAL])
            counts |= {"received": counts["received"] + queued, "queued": queued}
            values[JOURNAL] = json.dumps(counts)
    return first, second


def write_files(folder: Path, *parts: Contents) -> Path:
    """Write files of one recording into a new folder, and return the folder."""
    folder.mkdir(parents=True)
    for number, part in enumerate(parts):
        (file,) = write_contents(folder.parent / f"part{number}", part).glob("*.mcap")
        file.rename(folder / f"{folder.name}_{number}.mcap")
        file.parent.rmdir()
    return folder


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return heard_drive(tmp_path_factory.mktemp("heard") / "run", 3.6, snapshots_s=(0.0, 2.0))


@pytest.fixture(scope="module")
def forged(honest: Contents) -> Contents:
    change = changed(COMMANDS, lambda each, _: replace(each, data=MOTION), moves)
    return change(honest, Random(1))


def names_another_file(folder: Path) -> None:
    text = (
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - run_0.mcap\n    - run_1.mcap\n"
    )
    (folder / "metadata.yaml").write_text(text)


BESIDE: dict[str, Callable[[Path], object]] = {
    "a file of one byte after the others": lambda folder: (folder / "zz.mcap").write_bytes(b"x"),
    "a file of one byte before the others": lambda folder: (folder / "aa.mcap").write_bytes(b"x"),
    "a next file of one byte": lambda folder: (folder / "run_1.mcap").write_bytes(b"x"),
    "a next file that is named and not there": names_another_file,
}


@pytest.mark.parametrize("name", BESIDE)
def test_a_file_beside_excuses_no_forged_command(
    tmp_path: Path, honest: Contents, forged: Contents, name: str
) -> None:
    for folder, contents, verdict in (
        (tmp_path / "honest" / "run", honest, Verdict.INCOMPLETE),
        (tmp_path / "forged" / "run", forged, Verdict.BROKEN),
    ):
        BESIDE[name](write_contents(folder, contents))
        report = check_recording(folder)
        assert report.verdict is verdict
        assert report.missing


def test_a_parameter_that_the_journal_contradicts_excuses_no_forged_command(
    tmp_path: Path, forged: Contents
) -> None:
    edit = metadata("robotctl", "parameter.limits.linear_mps", "0.59")
    report = check_recording(write_contents(tmp_path / "run", edit(forged, Random(1))))
    assert report.verdict is Verdict.BROKEN
    assert any("the metadata says 0.59" in sentence for sentence in report.missing)


def test_files_of_one_recording_are_checked_together(tmp_path: Path, honest: Contents) -> None:
    report = check_recording(write_files(tmp_path / "run", *halves(honest)))
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])


@pytest.mark.parametrize("lost", [0, 1])
def test_a_file_that_is_lost_makes_nothing_broken(
    tmp_path: Path, honest: Contents, lost: int
) -> None:
    folder = write_files(tmp_path / "run", *halves(honest))
    (folder / f"run_{lost}.mcap").write_bytes(b"x")
    report = check_recording(folder)
    assert (report.verdict, report.violations) == (Verdict.INCOMPLETE, [])


@pytest.mark.parametrize("queued", [0, 1])
def test_the_finished_files_of_a_recording_that_goes_on_are_not_broken(
    tmp_path: Path, honest: Contents, queued: int
) -> None:
    """A message that arrives at a split is counted, and written to the next file."""
    first, _ = halves(honest, queued=queued)
    report = check_recording(write_files(tmp_path / "run", first))
    assert (report.verdict, report.violations) == (Verdict.INCOMPLETE, [])
    assert len(report.missing) == 1
    assert "the file with which it was closed is not here" in report.missing[0]


@pytest.mark.parametrize("queued", [0, 1])
def test_a_file_that_is_not_the_last_excuses_no_forged_command(
    tmp_path: Path, forged: Contents, queued: int
) -> None:
    first, _ = halves(forged, queued=queued)
    assert check_recording(write_files(tmp_path / "run", first)).verdict is Verdict.BROKEN


@pytest.mark.parametrize("number", [0, 1])
def test_a_note_tells_that_the_end_of_a_single_file_may_be_cut_off(
    tmp_path: Path, honest: Contents, number: int
) -> None:
    folder = write_files(tmp_path / "run", *halves(honest))
    report = check_recording(folder / f"run_{number}.mcap")
    assert report.verdict is Verdict.SAME
    assert (SINGLE_FILE in report.notes) is (number == 0)


def test_a_note_tells_of_a_single_file_that_was_cut_off(tmp_path: Path, honest: Contents) -> None:
    cut = honest.copy()
    last = [at for at, each in enumerate(honest.messages) if each.topic == COMMANDS][-40]
    del cut.messages[last + 1 :]
    folder = write_contents(tmp_path / "run", cut)
    assert check_recording(folder).verdict is Verdict.INCOMPLETE
    assert SINGLE_FILE in check_recording(folder / "run_0.mcap").notes
