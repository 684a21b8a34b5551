"""Recovery copies all that can be read of a broken file of any writer, and reports what is lost.

The next start repairs what a crash left, once, and changes nothing else.
"""

from __future__ import annotations

import errno
import os
import random
import shutil
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from zstandard import ZstdDecompressor

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.recording import read_info, read_messages
from robotctl.recording.format.disk import DiskFile
from robotctl.recording.keep import repair as repairing
from robotctl.recording.keep.recover import recover
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.indexing import find_unfinished_commit, index_from_summary, index_of
from robotctl.recording.read.records import InputFile
from robotctl.recording.read.whole_recording import verify_recording
from robotctl.testing.faults import FailingFile, mutated, zero
from tests.support.bags import SAMPLES, needs_samples
from tests.support.recordings import (
    Stored,
    Tape,
    bag_of,
    flip,
    foreign,
    metadata_of,
    numbered,
    overwrite,
    read_strictly,
    recorded,
    summary_of,
)


def theirs(path: Path, count: int, *, attachment: bool = False, **options: object) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 1024, **options})  # type: ignore[arg-type]
        writer.start(profile="theirs", library="somebody")
        schema = writer.register_schema("a/msg/B", "ros2idl", b"struct B {};")
        channels = [
            writer.register_channel("/a", "cdr", schema, metadata={"key": "value"}),
            writer.register_channel("/json", "json", 0),
        ]
        writer.add_metadata("notes", {"author": "somebody"})
        if attachment:
            writer.add_attachment(1, 2, "picture", "image/png", bytes(1000))
        for number in range(1, count + 1):
            writer.add_message(channels[number % 2], number, numbered(number), 7, number)
        writer.finish()
    return path


def test_a_whole_file_is_copied_without_loss(tmp_path: Path) -> None:
    source = theirs(tmp_path / "whole.mcap", 500)
    salvage = recover(source, tmp_path / "out.mcap")
    assert (salvage.message_count, salvage.lost) == (500, ())
    target = tmp_path / "out.mcap"
    assert read_strictly(target) == read_strictly(source)
    with target.open("rb") as stream:
        header = make_reader(stream).get_header()
    assert header.profile == "theirs"
    assert "recovered from somebody" in header.library
    summary, metadata = summary_of(target), dict(metadata_of(target))
    channels = {c.topic: c for c in summary.channels.values()}
    assert channels["/a"].metadata == {"key": "value"}
    assert summary.schemas[channels["/a"].schema_id].data == b"struct B {};"
    assert (channels["/json"].message_encoding, channels["/json"].schema_id) == ("json", 0)
    assert metadata == {"notes": {"author": "somebody"}, "robotctl.recovery": {"lost": ""}}


@pytest.mark.parametrize(
    "compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]
)
def test_a_cut_file_gives_a_valid_file_and_says_what_is_lost(
    tmp_path: Path, compression: CompressionType
) -> None:
    source = theirs(tmp_path / "cut.mcap", 500, compression=compression)
    source.write_bytes(source.read_bytes()[: source.stat().st_size // 2])
    salvage = recover(source, tmp_path / "out.mcap")
    assert salvage.lost
    found = read_strictly(tmp_path / "out.mcap")
    assert [m.sequence for m in found] == list(range(1, len(found) + 1))
    assert len(found) == salvage.message_count > 100
    assert read_info(tmp_path / "out.mcap").metadata["robotctl.recovery"] == {
        "lost": "\n".join(salvage.lost)
    }


def test_a_damaged_attachment_is_said_to_be_lost(tmp_path: Path) -> None:
    source = theirs(tmp_path / "file.mcap", 10, attachment=True)
    flip(source, source.read_bytes().index(bytes(900)) + 100)
    (lost,) = recover(source, tmp_path / "out.mcap").lost
    assert "attachment" in lost
    assert "its checksum is wrong" in lost
    with (tmp_path / "out.mcap").open("rb") as stream:
        assert list(make_reader(stream, validate_crcs=True).iter_attachments()) == []


def test_what_recovery_makes_is_what_the_reader_gives(tmp_path: Path) -> None:
    dice = random.Random(10)
    sources = [
        recorded(tmp_path / "run", 200).read_bytes(),
        theirs(tmp_path / "a.mcap", 200, compression=CompressionType.NONE).read_bytes(),
        theirs(tmp_path / "b.mcap", 200, use_chunking=False).read_bytes(),
    ]
    broken, target = tmp_path / "broken.mcap", tmp_path / "out.mcap"
    salvaged = 0
    for _ in range(60):
        broken.write_bytes(mutated(dice.choice(sources), dice))
        missing: list[str] = []
        try:
            salvage = recover(broken, target)
        except UnreadableFile:
            assert not target.exists()
            continue
        salvaged += 1
        read = [
            Stored(m.topic, m.data, m.log_ns, m.publish_ns, m.sequence)
            for m in read_messages(broken, on_missing=missing.append)
        ]
        assert sorted(read_strictly(target)) == sorted(read)
        assert bool(missing) <= bool(salvage.lost)
        target.unlink()
    assert salvaged > 30


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: path.write_bytes(b""), "it is empty"),
        (lambda path: path.write_bytes(b"nonsense" * 100), "it is not an MCAP file"),
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "is not a regular file"),
        (os.mkfifo, "is not a regular file"),
        (
            lambda path: path.write_bytes(recorded(path.parent / "run", 100).read_bytes()[:100]),
            "holds no readable message",
        ),
    ],
)
def test_nothing_to_salvage_is_one_sentence_and_no_file(
    tmp_path: Path, make: Callable[[Path], object], reason: str
) -> None:
    make(tmp_path / "bad.mcap")
    with pytest.raises(UnreadableFile, match=reason):
        recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_a_full_disk_leaves_no_half_target(tmp_path: Path) -> None:
    source = recorded(tmp_path / "run", 500)
    with pytest.raises(Refused, match="No space left"):
        recover(
            source,
            tmp_path / "out.mcap",
            open_file=lambda path: FailingFile(path, 3, code=errno.ENOSPC),
        )
    assert not (tmp_path / "out.mcap").exists()


@needs_samples
def test_bags_of_rosbag2_are_copied_whole_and_salvaged_when_cut(tmp_path: Path) -> None:
    for source in sorted(SAMPLES.glob("*/*.mcap")):
        target = tmp_path / source.name
        salvage = recover(source, target)
        assert salvage.lost == ()
        assert sorted(read_strictly(target)) == sorted(read_strictly(source))
        cut = tmp_path / f"cut_{source.name}"
        cut.write_bytes(source.read_bytes()[:-200])
        recover(cut, tmp_path / f"out_{source.name}")
        assert {number.data for number in read_strictly(tmp_path / f"out_{source.name}")} <= {
            message.data for message in read_strictly(source)
        }


def repair(recordings: Path) -> list[str]:
    return [done.text for done in repairing.repair(recordings)]


def crashed(folder: Path, count: int) -> Path:
    """Record `count` messages and leave the file as a killed process does."""
    recorder = Tape(folder, chunk_bytes=1024, flush_s=0.005)
    listed = (folder / "metadata.yaml").read_bytes()  # from before the first message
    recorder.commands(range(1, count + 1))
    recorder.settle()
    file = folder / f"{folder.name}_0.mcap"
    data = file.read_bytes()
    recorder.close()
    file.write_bytes(data)
    (folder / "metadata.yaml").write_bytes(listed)
    return file


def listed_messages(folder: Path) -> int:
    count: int = bag_of(folder)["message_count"]
    return count


def test_a_file_that_was_not_closed_is_checked_once_and_the_bag_counts_it(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 200)
    assert listed_messages(tmp_path / "run") == 0
    before = read_strictly(file)
    assert repair(tmp_path) == [
        "repaired: run_0.mcap was not closed: its 200 messages are complete"
    ]
    assert read_strictly(file) == before
    assert listed_messages(tmp_path / "run") == 200
    names = [name for name, _ in metadata_of(file)]
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
    with InputFile(file) as opened:
        middle = index_from_summary(opened).places[3].offset + 200
    zero(file, middle, middle + 50)
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


def test_what_is_written_or_closed_and_files_of_others_are_not_touched(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "live")
    (tmp_path / "theirs").mkdir()
    torn = foreign(tmp_path / "theirs" / "theirs_0.mcap", 1)
    whole = torn.read_bytes()
    torn.write_bytes(whole[:-20])
    closed = recorded(tmp_path / "closed", 10).parent
    before_of = {path: path.read_bytes() for path in closed.iterdir()}
    elsewhere = crashed(tmp_path / "away" / "linked", 10)
    (tmp_path / "linked").symlink_to(elsewhere.parent)
    before = elsewhere.read_bytes()
    assert repair(tmp_path) == []
    assert torn.read_bytes() == whole[:-20]
    assert {path: path.read_bytes() for path in closed.iterdir()} == before_of
    assert elsewhere.read_bytes() == before
    recorder.commands(range(1, 11))
    assert len(read_strictly(recorder.close().file)) == 10


def test_a_link_in_a_recording_is_not_followed(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    crashed(recordings / "run", 10)
    elsewhere = crashed(tmp_path / "elsewhere", 10)
    before = elsewhere.read_bytes()
    (recordings / "run" / "run_1.mcap").symlink_to(elsewhere)
    assert len(repair(recordings)) == 1
    assert elsewhere.read_bytes() == before


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
        monkeypatch.setattr("robotctl.recording.read.read_limits.UNPACKED_BYTES", 500)
        monkeypatch.setattr("robotctl.recording.read.read_limits.UNPACKED_RATIO", 0)
    else:
        monkeypatch.setattr("robotctl.recording.read.read_limits.RECORDS", 150)
        monkeypatch.setattr("robotctl.recording.read.read_limits.BYTES_PER_RECORD", 1e9)
    (sentence,) = repair(tmp_path)
    assert "is left as it is" in sentence
    assert file.read_bytes() == content
    assert [path.name for path in file.parent.glob("*.repair")] == []


Read = Callable[[int, int, int], bytes]


def break_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the first read of a compressed chunk fail as a broken disk does."""
    pread: Read = os.pread
    failed: list[int] = []

    def failing(fd: int, length: int, offset: int) -> bytes:
        data = pread(fd, length, offset)
        if not failed and data.startswith(b"\x28\xb5\x2f\xfd"):
            failed.append(offset)
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return data

    monkeypatch.setattr("robotctl.recording.read.files.os.pread", failing)


def lack_memory_once(monkeypatch: pytest.MonkeyPatch) -> None:
    failed: list[bytes] = []

    class OnceNoMemory:
        def decompress(self, data: bytes, *, max_output_size: int) -> bytes:
            if not failed:
                failed.append(data)
                raise MemoryError
            return ZstdDecompressor().decompress(data, max_output_size=max_output_size)

    monkeypatch.setattr("robotctl.recording.read.chunks.ZstdDecompressor", OnceNoMemory)


@pytest.mark.parametrize("torn", [False, True])
@pytest.mark.parametrize(
    ("fail_once", "why"),
    [
        (break_once, "the disk cannot read it at byte"),
        (lack_memory_once, "no memory for a chunk of"),
    ],
)
def test_what_cannot_be_read_now_is_left_for_the_next_start(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    torn: bool,
    fail_once: Callable[[pytest.MonkeyPatch], None],
    why: str,
) -> None:
    file = crashed(tmp_path / "run", 200)
    if torn:
        file.write_bytes(file.read_bytes()[:-10])
    before, listed = file.read_bytes(), listed_messages(tmp_path / "run")
    fail_once(monkeypatch)
    (sentence,) = repair(tmp_path)
    assert f"run_0.mcap could not be repaired: {why}" in sentence
    assert file.read_bytes() == before
    assert listed_messages(tmp_path / "run") == listed
    assert len(repair(tmp_path)) == 1  # the disk works again
    assert len(read_strictly(file)) == 200


def test_a_full_disk_leaves_the_file_as_it_was_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = crashed(tmp_path / "run", 200)
    before = file.read_bytes()
    write_at = DiskFile.write_at
    failed = False

    def failing(self: DiskFile, parts: Sequence[bytes], offset: int) -> None:
        nonlocal failed
        if not failed:
            failed = True
            write_at(self, [b"".join(parts)[:100]], offset)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write_at(self, parts, offset)

    with monkeypatch.context() as patched:
        patched.setattr(DiskFile, "write_at", failing)
        (done,) = repairing.repair(tmp_path)
    assert done.problem
    assert "run_0.mcap could not be repaired: No space left on device" in done.text
    assert file.read_bytes() == before
    assert repair(tmp_path) == [
        "repaired: run_0.mcap was not closed: its 200 messages are complete"
    ]


def test_a_file_that_cannot_be_repaired_keeps_no_other_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = crashed(tmp_path / "run0", 100)
    for number in (1, 2):
        shutil.copy(file, tmp_path / "run0" / f"run0_{number}.mcap")
    crashed(tmp_path / "run1", 100)

    def failing(file: InputFile, index: FileIndex, data_end: int) -> int | None:
        if file.path.name == "run0_1.mcap":
            raise ValueError("a surprise")
        return find_unfinished_commit(file, index, data_end)

    monkeypatch.setattr(repairing, "find_unfinished_commit", failing)
    sentences = repair(tmp_path)
    assert [sentence.split(" was ")[0] for sentence in sentences] == [
        "repaired: run0_0.mcap",
        "run0_1.mcap could not be repaired: ValueError('a surprise') (the next start tries again)",
        "repaired: run0_2.mcap",
        "repaired: run1_0.mcap",
    ]
    assert listed_messages(tmp_path / "run0") == 300


def test_the_list_of_a_bag_counts_what_was_repaired_before_the_end(tmp_path: Path) -> None:
    first, second = crashed(tmp_path / "run", 100), tmp_path / "run" / "run_1.mcap"
    shutil.copy(first, second)
    done = repairing.repair(tmp_path)
    next(done)
    done.close()  # type: ignore[attr-defined]
    assert listed_messages(tmp_path / "run") == 200


@pytest.mark.parametrize("torn", [False, True])
def test_a_repair_that_was_killed_before_the_list_breaks_nothing_and_the_next_one_writes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torn: bool
) -> None:
    def killed(*arguments: object) -> None:
        raise KeyboardInterrupt

    file = crashed(tmp_path / "run", 100)
    if torn:
        file.write_bytes(file.read_bytes()[:-10])
    os.utime(tmp_path / "run" / "metadata.yaml", ns=(0, 0))
    with monkeypatch.context() as patch:
        patch.setattr(repairing, "rewrite_metadata", killed)
        with pytest.raises(KeyboardInterrupt):
            repair(tmp_path)
    assert listed_messages(tmp_path / "run") == 0
    assert verify_recording(tmp_path / "run").wrong == ()
    assert repair(tmp_path) == []
    assert listed_messages(tmp_path / "run") == 100


def test_a_repair_removes_what_an_interrupted_one_left_and_nothing_else(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 100)
    file.write_bytes(file.read_bytes()[:-10])
    (tmp_path / "run" / "run_0.mcap.repair").write_bytes(b"half")
    notes = tmp_path / "run" / "how to.repair"
    notes.write_text("a user's")
    assert len(repair(tmp_path)) == 1
    assert len(read_strictly(file)) == 100
    assert not (tmp_path / "run" / "run_0.mcap.repair").exists()
    assert notes.read_text() == "a user's"


def test_a_foreign_record_among_the_chunks_cuts_off_none_of_them(tmp_path: Path) -> None:
    file = crashed(tmp_path / "run", 200)
    before = read_strictly(file)
    with InputFile(file) as source:
        place = index_of(source).places[1]
        offset = place.offset + place.length
        assert source.record(offset).opcode == Opcode.MESSAGE_INDEX
    overwrite(file, offset, b"\x90")
    assert len(repair(tmp_path)) == 1
    assert [message.data for message in read_strictly(file)] == [m.data for m in before]


def with_private_record(data: bytes) -> bytes:
    """Return the file with a private record at the end of its summary."""
    footer_bytes, magic_bytes = 29, 8
    footer = len(data) - footer_bytes - magic_bytes
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    summary = data[start:footer] + struct.pack("<BQ", 0x90, 3) + b"abc"
    end = data[footer : footer + footer_bytes - 4]
    crc = zlib.crc32(summary + end)
    return data[:start] + summary + end + struct.pack("<I", crc) + data[-magic_bytes:]


def test_a_private_record_in_a_summary_does_not_stop_the_repair(tmp_path: Path) -> None:
    first, second = crashed(tmp_path / "run1", 100), crashed(tmp_path / "run2", 100)
    first.write_bytes(with_private_record(first.read_bytes()))
    assert repair(tmp_path) == [
        "repaired: run1_0.mcap was not closed: its 100 messages are complete",
        "repaired: run2_0.mcap was not closed: its 100 messages are complete",
    ]
    assert len(read_strictly(first)) == len(read_strictly(second)) == 100
