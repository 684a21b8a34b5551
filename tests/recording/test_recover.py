"""Recovery copies all that can be read of a broken file of any writer, and reports what is lost."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from robotctl.errors import Refused, UnreadableFile
from robotctl.recording import Recorder, RecorderOptions, read_info, read_messages
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.recover import recover
from robotctl.testing.drives import START_NS, TWIST
from robotctl.testing.faults import FailingFile, mutated, record_boundaries
from tests.support.recordings import number_of, numbered, read_strictly, write_numbered

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "rosbag2"
needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"no sample bags at {SAMPLES}")


def ours(folder: Path, count: int) -> Path:
    recorder = Recorder(folder, RecorderOptions(chunk_bytes=1024), on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, count + 1))
    return recorder.close().file


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
    copied = read_strictly(tmp_path / "out.mcap")
    assert copied == read_strictly(source)
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "theirs"
        assert "recovered from somebody" in reader.get_header().library
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert summary is not None
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


def attachments_of(path: Path) -> list[tuple[str, str, int, int, bytes]]:
    with path.open("rb") as stream:
        return [
            (each.name, each.media_type, each.log_time, each.create_time, each.data)
            for each in make_reader(stream, validate_crcs=True).iter_attachments()
        ]


def test_attachments_are_kept(tmp_path: Path) -> None:
    source = theirs(tmp_path / "file.mcap", 10, attachment=True)
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    assert recover(source, whole).lost == ()
    source.write_bytes(source.read_bytes()[:-100])
    assert recover(source, cut).lost
    for target in (whole, cut):
        assert len(read_strictly(target)) == 10
        assert attachments_of(target) == [("picture", "image/png", 2, 1, bytes(1000))]


def test_a_damaged_attachment_is_said_to_be_lost(tmp_path: Path) -> None:
    source = theirs(tmp_path / "file.mcap", 10, attachment=True)
    data = bytearray(source.read_bytes())
    data[data.index(bytes(900)) + 100] = 1
    source.write_bytes(data)
    (lost,) = recover(source, tmp_path / "out.mcap").lost
    assert "attachment" in lost
    assert "its checksum is wrong" in lost
    assert attachments_of(tmp_path / "out.mcap") == []


def test_metadata_of_one_name_is_all_kept(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    for number in range(3):
        recorder.add_event(RecordedEvent(EventKind.MARK, START_NS + number, f"mark {number}"))
    recover(recorder.close().file, tmp_path / "out.mcap")
    assert [event.text for event in read_info(tmp_path / "out.mcap").events] == [
        "mark 0",
        "mark 1",
        "mark 2",
    ]


def test_a_damaged_chunk_is_left_out(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 200)
    data = bytearray(source.read_bytes())
    chunks = [offset for offset in record_boundaries(bytes(data)) if data[offset] == Opcode.CHUNK]
    data[chunks[5] + 80] ^= 0xFF
    source.write_bytes(data)
    salvage = recover(source, tmp_path / "out.mcap")
    assert len(salvage.lost) == 1
    found = [m.sequence for m in read_strictly(tmp_path / "out.mcap")]
    assert 150 < len(found) < 200
    assert found == sorted(found)


def test_what_recovery_makes_is_what_the_reader_gives(tmp_path: Path) -> None:
    dice = random.Random(10)
    sources = [
        ours(tmp_path / "run", 200).read_bytes(),
        theirs(tmp_path / "a.mcap", 200, compression=CompressionType.NONE).read_bytes(),
        theirs(tmp_path / "b.mcap", 200, use_chunking=False).read_bytes(),
    ]
    broken, target = tmp_path / "broken.mcap", tmp_path / "out.mcap"
    salvaged = 0
    for _ in range(200):
        broken.write_bytes(mutated(dice.choice(sources), dice))
        missing: list[str] = []
        try:
            salvage = recover(broken, target)
        except UnreadableFile:
            assert not target.exists()
            continue
        salvaged += 1
        read = [
            (m.topic, m.data, m.log_ns, m.publish_ns, m.sequence)
            for m in read_messages(broken, on_missing=missing.append)
        ]
        assert sorted(read_strictly(target)) == sorted(read)
        assert bool(missing) <= bool(salvage.lost)
        target.unlink()
    assert salvaged > 100


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: path.write_bytes(b""), "it is empty"),
        (lambda path: path.write_bytes(b"nonsense" * 100), "it is not an MCAP file"),
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "is not a regular file"),
        (os.mkfifo, "is not a regular file"),
    ],
)
def test_nothing_to_salvage_is_one_sentence_and_no_file(
    tmp_path: Path, make: Callable[[Path], object], reason: str
) -> None:
    make(tmp_path / "bad.mcap")
    with pytest.raises(UnreadableFile, match=reason):
        recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_a_header_alone_is_nothing_to_salvage(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 100)
    source.write_bytes(source.read_bytes()[:100])
    with pytest.raises(UnreadableFile, match="holds no readable message"):
        recover(source, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_a_target_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 10)
    (tmp_path / "out.mcap").write_text("mine")
    with pytest.raises(Refused, match="File exists"):
        recover(source, tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_text() == "mine"


def test_a_full_disk_leaves_no_half_target(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 500)
    with pytest.raises(Refused, match="No space left"):
        recover(
            source,
            tmp_path / "out.mcap",
            open_file=lambda path: FailingFile(path, 3, code=errno.ENOSPC),
        )
    assert not (tmp_path / "out.mcap").exists()


def test_progress_runs_from_nothing_to_all(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 500)
    source.write_bytes(source.read_bytes()[:-30])
    steps: list[tuple[int, int]] = []
    recover(source, tmp_path / "out.mcap", on_progress=lambda d, t: steps.append((d, t)))
    done = [step for step, _ in steps]
    assert done == sorted(done)
    assert steps[-1] == (2 * source.stat().st_size, 2 * source.stat().st_size)


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


def test_numbers_survive(tmp_path: Path) -> None:
    source = ours(tmp_path / "run", 50)
    recover(source, tmp_path / "out.mcap")
    messages = list(read_messages(tmp_path / "out.mcap"))
    assert [number_of(m.data) for m in messages] == list(range(1, 51))
    assert messages[0].log_ns == START_NS + 1_000_000
