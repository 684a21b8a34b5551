"""A recording that was shortened is reported, even if each of its files is valid."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from robotctl.recording import Recorder, RecorderOptions, Recording, read_info
from robotctl.recording.disk.storage import Storage
from robotctl.recording.keep.listing import list_recording
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.journal_reader import read_journal
from robotctl.testing.drives import TWIST, drive, record
from robotctl.testing.faults import FailingFile, chunks_of
from tests.support.recordings import recorded, salvaged, write_numbered


def recorded_twice(folder: Path) -> tuple[Path, bytes]:
    """Return a recording of 500 messages, and the content of its file at 200 messages."""
    recorder = Recorder(folder, RecorderOptions(chunk_bytes=1024), on_failure=pytest.fail)
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 201))
    while recorder.stats().queued:
        time.sleep(0.001)
    earlier = recorder.stats().file.read_bytes()
    write_numbered(recorder, channel, range(201, 501))
    return recorder.close().file, earlier


@pytest.mark.parametrize("by_folder", [True, False])
def test_an_earlier_state_of_a_file_is_not_taken_for_all_of_it(
    tmp_path: Path, by_folder: bool
) -> None:
    file, earlier = recorded_twice(tmp_path / "run")
    file.write_bytes(earlier)  # a whole and valid file
    path = file.parent if by_folder else file
    named = "run_0.mcap: metadata.yaml counts 500 messages, and 200 are there"
    assert read_info(path).missing == (named,)
    assert salvaged(path)[1] == [named]
    assert list_recording(path).damage == (named,)
    work = recover_folder if by_folder else recover
    assert named in "; ".join(work(path, tmp_path / "saved").lost)
    assert read_info(tmp_path / "saved").missing == ()


def test_what_the_ledger_counts_is_missed_without_metadata_yaml(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", RecorderOptions(chunk_bytes=1024), on_failure=pytest.fail)
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 201))
    recorder.split()
    write_numbered(recorder, channel, range(201, 401))
    recorder.close()
    assert read_info(tmp_path / "run").missing == ()
    other = recorded(tmp_path / "other" / "run", 50)
    (tmp_path / "run" / "run_0.mcap").write_bytes(other.read_bytes())
    (tmp_path / "run" / "metadata.yaml").unlink()
    (named,) = read_info(tmp_path / "run").missing
    assert named == "its ledger counts 400 messages, and 250 are there"


def test_a_recording_whose_first_file_was_removed_lacks_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", RecorderOptions(chunk_bytes=1024), on_failure=pytest.fail)
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 201))
    recorder.split()
    write_numbered(recorder, channel, range(201, 401))
    recorder.close()
    (tmp_path / "run" / "run_0.mcap").unlink()
    (tmp_path / "run" / "metadata.yaml").unlink()
    assert read_info(tmp_path / "run").missing == ()
    assert read_info(tmp_path / "run" / "run_1.mcap").missing == ()


@pytest.mark.parametrize("fail_at", [3, 5, 12])
@pytest.mark.parametrize("size", [52, 5000])
def test_a_recording_that_a_full_disk_ended_says_nothing_untrue(
    tmp_path: Path, fail_at: int, size: int
) -> None:
    def full_disk(path: Path, *_: object, **__: object) -> Storage:
        return FailingFile(path, fail_at)

    failures: list[str] = []
    options = RecorderOptions(chunk_bytes=1024, open_file=full_disk)
    recorder = Recorder(tmp_path / "run", options, on_failure=failures.append)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 301), size)
    written = recorder.close().written
    assert failures
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (written, ())


def test_a_file_that_is_cut_while_it_is_read_is_named(tmp_path: Path) -> None:
    (file,) = record(tmp_path / "run", drive(2.0)).glob("*.mcap")
    chunks = chunks_of(file.read_bytes())
    missing: list[str] = []
    with Recording(file) as recording:
        entries = read_journal(recording, missing.append)
        next(entries)
        with file.open("r+b") as stream:
            stream.truncate(chunks[len(chunks) // 2][0] + 20)
        assert sum(1 for _ in entries) > 10
    assert missing
    assert all(
        re.search(r"it was truncated at byte \d+ while it was read", each) for each in missing
    )


def test_a_file_of_a_bag_that_says_too_much_of_it_is_no_loss(tmp_path: Path) -> None:
    """The counts per file of rosbag2 include messages that its cache dropped; its total not."""
    file = recorded(tmp_path / "run", 100)
    file.write_bytes(file.read_bytes().replace(b"robotctl ", b"somebody "))
    yaml = tmp_path / "run" / "metadata.yaml"
    yaml.write_text(re.sub(r"(    message_count:) 100\n", r"\1 120\n", yaml.read_text()))
    assert "message_count: 120" in yaml.read_text()
    assert read_info(tmp_path / "run").missing == ()
    yaml.write_text(
        re.sub(r"\n  message_count: 100\n", r"\n  message_count: 120\n", yaml.read_text())
    )
    assert read_info(tmp_path / "run").missing == (
        "metadata.yaml counts 120 messages, and 100 are there",
    )
