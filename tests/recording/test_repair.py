"""The next start makes whole what a crash has left, once, and touches nothing else."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer

from robotctl.recording import repair as repairing
from robotctl.recording.reader import read_info
from robotctl.recording.recorder import Recorder, RecorderOptions
from robotctl.testing.recordings import TWIST, numbered, read_strictly, write_numbered
from robotctl.testing.waiting import until


def repair(recordings: Path) -> list[str]:
    return [done.text for done in repairing.repair(recordings)]


def crashed(folder: Path, count: int) -> Path:
    """What a process leaves that is killed after `count` messages reached the file."""
    options = RecorderOptions(chunk_bytes=1024, flush_s=0.005)
    recorder = Recorder(folder, options, on_failure=pytest.fail)
    listed = (folder / "metadata.yaml").read_bytes()  # the list of before the first message
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, count + 1))
    until(lambda: recorder.stats().queued == 0)
    file = folder / f"{folder.name}_0.mcap"
    data = file.read_bytes()
    recorder.close()
    file.write_bytes(data)
    (folder / "metadata.yaml").write_bytes(listed)
    return file


def listed_messages(folder: Path) -> int:
    bag = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    count: int = bag["message_count"]
    return count


def test_a_file_that_was_not_closed_is_checked_once_and_the_bag_counts_it(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 200)
    assert listed_messages(tmp_path / "run") == 0
    before = read_strictly(file)
    assert repair(tmp_path) == ["repaired: run_0.mcap was not closed: its 200 messages are whole"]
    assert read_strictly(file) == before
    assert listed_messages(tmp_path / "run") == 200
    with file.open("rb") as stream:
        names = [record.name for record in make_reader(stream).iter_metadata()]
    assert names == ["robotctl", "rosbag2", "robotctl.recovery"]
    assert repair(tmp_path) == []


def test_a_torn_file_is_replaced_by_what_can_be_read(tmp_path: Path) -> None:
    dice = random.Random(11)
    for number in range(20):
        file = crashed(tmp_path / f"run{number}", 200)
        data = file.read_bytes()
        file.write_bytes(data[: dice.randint(len(data) // 2, len(data) - 10)])
    sentences = repair(tmp_path)
    assert len(sentences) == 20
    for number in range(20):
        found = read_strictly(tmp_path / f"run{number}" / f"run{number}_0.mcap")
        assert [m.data for m in found] == [numbered(n) for n in range(1, len(found) + 1)]
        assert listed_messages(tmp_path / f"run{number}") == len(found) > 0
        assert read_info(tmp_path / f"run{number}").missing == ()
    assert repair(tmp_path) == []


def test_a_chunk_that_a_power_cut_has_emptied_is_taken_out(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 500)
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 50] = bytes(50)
    file.write_bytes(data)
    (sentence,) = repair(tmp_path)
    assert sentence.startswith("repaired: run_0.mcap was torn: ")
    assert 400 < len(read_strictly(file)) < 500


def test_what_cannot_be_repaired_stays_as_it_is(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 100)
    data = file.read_bytes()[:100]
    file.write_bytes(data)
    (sentence,) = repair(tmp_path)
    assert "was torn and cannot be repaired" in sentence
    assert file.read_bytes() == data
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "metadata.yaml",
        "run_0.mcap",
    ]


def test_a_closed_recording_is_not_touched(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    recorder.close()
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    assert repair(tmp_path) == []
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_a_recording_in_progress_and_files_of_others_are_not_touched(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "live", on_failure=pytest.fail)
    (tmp_path / "theirs").mkdir()
    with (tmp_path / "theirs" / "theirs_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="somebody")
        channel = writer.register_channel("/a", "cdr", 0)
        writer.add_message(channel, 1, b"x", 1)
        writer.finish()
    whole = (tmp_path / "theirs" / "theirs_0.mcap").read_bytes()
    (tmp_path / "theirs" / "theirs_0.mcap").write_bytes(whole[:-20])
    elsewhere = crashed(tmp_path / "away" / "linked", 10)
    (tmp_path / "linked").symlink_to(elsewhere.parent)
    before = elsewhere.read_bytes()
    assert repair(tmp_path) == []
    assert (tmp_path / "theirs" / "theirs_0.mcap").read_bytes() == whole[:-20]
    assert elsewhere.read_bytes() == before
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    assert len(read_strictly(recorder.close().file)) == 10


def test_a_link_in_a_recording_is_not_followed(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    crashed(recordings / "run", 10)
    elsewhere = crashed(tmp_path / "elsewhere", 10)
    before = elsewhere.read_bytes()
    (recordings / "run" / "run_1.mcap").symlink_to(elsewhere)
    assert len(repair(recordings)) == 1
    assert elsewhere.read_bytes() == before


def test_a_repair_that_was_interrupted_leaves_no_trace(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 100)
    file.write_bytes(file.read_bytes()[:-10])
    (tmp_path / "run" / "run_0.mcap.repair").write_bytes(b"half")
    assert len(repair(tmp_path)) == 1
    assert len(read_strictly(file)) == 100
    assert not (tmp_path / "run" / "run_0.mcap.repair").exists()


@pytest.mark.parametrize("torn", [False, True])
@pytest.mark.parametrize("limit", ["UNPACKED", "RECORD"])
def test_what_is_too_much_to_read_is_left_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torn: bool, limit: str
) -> None:
    file = crashed(tmp_path / "run", 200)
    if torn:
        file.write_bytes(file.read_bytes()[:-30])
    content = file.read_bytes()
    if limit == "UNPACKED":
        monkeypatch.setattr("robotctl.recording.read_limits.UNPACKED_BYTES", 500)
        monkeypatch.setattr("robotctl.recording.read_limits.UNPACKED_RATIO", 0)
    else:
        monkeypatch.setattr("robotctl.recording.read_limits.RECORDS", 150)
        monkeypatch.setattr("robotctl.recording.read_limits.BYTES_PER_RECORD", 1e9)
    (sentence,) = repair(tmp_path)
    assert "is left as it is" in sentence
    assert file.read_bytes() == content
    assert [path.name for path in file.parent.glob("*.repair")] == []
