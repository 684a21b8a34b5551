"""Bags that rosbag2 compressed are read; of an sqlite3 bag the command that converts it is told."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from zstandard import ZstdCompressor, ZstdDecompressor

from robotctl.errors import UnreadableFile
from robotctl.recording import Recording, read_info, read_messages
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.listing import list_recording
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.messages import ALWAYS
from tests.support.bags import START_NS, data, talk, write_bag
from tests.support.recordings import read_strictly, salvaged

LINES = talk("/alpha", 50)
SENT = data(LINES)


def metadata(mode: str, form: str = "zstd", files: tuple[str, ...] = ("bag_0.mcap",)) -> str:
    """Return the beginning of rosbag2's metadata, indented as in its `metadata.yaml`."""
    listed = "".join(f"    - {name}\n" for name in files)
    return (
        "  version: 9\n  storage_identifier: mcap\n"
        f"  compression_format: {form}\n  compression_mode: {mode}\n"
        f"  relative_file_paths:\n{listed}"
    )


def bag(
    folder: Path,
    messages: list[bytes],
    *,
    mode: str = "MESSAGE",
    form: str = "zstd",
    told_by: str = "both",
) -> Path:
    """Write a bag with these messages as rosbag2 does; `told_by` is yaml, file or both."""
    folder.mkdir()
    with (folder / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1000)
        writer.start("ros2", "libmcap 1.1.0")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/alpha", "cdr", schema)
        for number, message in enumerate(messages):
            at_ns = START_NS + number * 10**6
            writer.add_message(channel, at_ns, message, at_ns, number)
        if told_by != "yaml":
            writer.add_metadata("rosbag2", {"serialized_metadata": metadata(mode, form)})
        writer.finish()
    if told_by != "file":
        text = f"rosbag2_bagfile_information:\n{metadata(mode, form)}"
        (folder / "metadata.yaml").write_text(text)
    return folder


def compressed(messages: list[bytes]) -> list[bytes]:
    return [ZstdCompressor().compress(message) for message in messages]


@pytest.mark.parametrize("told_by", ["both", "yaml", "file"])
@pytest.mark.parametrize("mode", ["MESSAGE", "message"])
def test_messages_that_were_compressed_one_by_one_are_read(
    tmp_path: Path, told_by: str, mode: str
) -> None:
    folder = bag(tmp_path / "bag", compressed(SENT), mode=mode, told_by=told_by)
    for path in (folder, folder / "bag_0.mcap"):
        assert read_info(path).missing == ()
        assert [message.data for message in read_messages(path)] == SENT
        with Recording(path) as recording:
            missing: list[str] = []
            assert [m.data for m in recording.in_order_written(None, missing.append)] == SENT
            last = recording.last_before(START_NS + 10**12, {"/alpha": 3}, missing.append)
            assert [m.data for m in last] == SENT[-3:]
            clip = cut_clip(recording, Moment(START_NS), ALWAYS, tmp_path / f"{path.name}.clip")
        assert (missing, clip.lost) == ([], ())
        assert [m.data for m in read_strictly(clip.target)] == SENT


def test_what_is_recovered_is_compressed_no_more(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", compressed(SENT))
    salvage = recover_folder(folder, tmp_path / "saved")
    assert (salvage.message_count, salvage.lost) == (len(SENT), ())
    for path in (tmp_path / "saved", tmp_path / "saved" / "bag_0.mcap"):
        assert [message.data for message in read_messages(path)] == SENT
    assert [m.data for m in read_strictly(tmp_path / "saved" / "bag_0.mcap")] == SENT
    with (tmp_path / "saved" / "bag_0.mcap").open("rb") as stream:
        (record, _) = make_reader(stream).iter_metadata()
    told = yaml.safe_load(record.metadata["serialized_metadata"])
    assert (told["compression_mode"], told["compression_format"]) == ("", "")


def test_other_modes_leave_the_messages_alone(tmp_path: Path) -> None:
    for number, mode in enumerate(["NONE", "FILE", '""']):
        folder = bag(tmp_path / f"bag{number}", SENT, mode=mode)
        assert [message.data for message in read_messages(folder)] == SENT


def test_a_file_that_the_bag_does_not_name_is_left_alone(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", compressed(SENT), told_by="yaml")
    stray = write_bag(folder / "stray.mcap", LINES)
    assert [message.data for message in read_messages(stray)] == SENT


def test_a_message_that_cannot_be_decompressed_is_missing(tmp_path: Path) -> None:
    stored = compressed(SENT)
    stored[7] = b"\0\1\0\0 this is no frame"
    stored[8] = stored[8][:-3]
    folder = bag(tmp_path / "bag", stored)
    messages, missing = salvaged(folder)
    assert [message.data for message in messages] == SENT[:7] + SENT[9:]
    assert missing
    assert all("messages are not compressed as the metadata says" in each for each in missing)
    salvage = recover(folder / "bag_0.mcap", tmp_path / "out.mcap")
    assert salvage.message_count == len(SENT) - 2
    assert salvage.lost


def test_messages_that_claim_to_be_huge_are_not_unpacked(tmp_path: Path) -> None:
    bombs = [ZstdCompressor().compress(bytes(100 << 20))] * 2
    bombs += [ZstdCompressor().compress(bytes(60 << 20))] * 20
    folder = bag(tmp_path / "bag", [*compressed(SENT[:1]), *bombs])
    count = 0
    missing: list[str] = []
    for _ in read_messages(folder, on_missing=missing.append):
        count += 1
    assert 1 < count < 12
    text = "\n".join(missing)
    assert f"a message claims {100 << 20} bytes, more than" in text
    assert "unpacked it would take more than 512 MiB" in text


def test_a_format_without_a_name_we_know_is_told(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", SENT, form="lz4")
    messages, missing = salvaged(folder)
    assert messages == []
    assert missing == [
        "bag_0.mcap: its messages are compressed with lz4, one by one: this is not supported"
    ]


def plainly(content: bytes) -> bytes:
    return ZstdCompressor().compress(content)


def packed(folder: Path, content: Callable[[bytes], bytes] = plainly) -> Path:
    """Write a bag whose only file is compressed as a whole."""
    folder.mkdir()
    plain = write_bag(folder / "bag_0.mcap", LINES, chunk_bytes=1000)
    path = folder / "bag_0.mcap.zstd"
    path.write_bytes(content(plain.read_bytes()))
    plain.unlink()
    text = f"rosbag2_bagfile_information:\n{metadata('FILE', files=(path.name,))}"
    (folder / "metadata.yaml").write_text(text)
    return path


def test_a_file_that_was_compressed_as_a_whole_is_read(tmp_path: Path) -> None:
    file = packed(tmp_path / "bag")
    for path in (file, file.parent):
        info = read_info(path)
        assert (info.message_count, info.missing, info.indexed) == (len(SENT), (), True)
        assert [message.data for message in read_messages(path)] == SENT
        assert list_recording(path).damage == ()
    salvage = recover_folder(file.parent, tmp_path / "saved")
    assert salvage.lost == ()
    assert [m.data for m in read_strictly(tmp_path / "saved" / "bag_0.mcap")] == SENT
    steps: list[tuple[int, int]] = []
    Recording(file, on_progress=lambda done, total: steps.append((done, total))).close()
    assert steps[-1] == (file.stat().st_size, file.stat().st_size)


@pytest.mark.parametrize("keep_packed", [True, False])
def test_a_file_that_was_unpacked_beside_its_bag_is_not_missing(
    tmp_path: Path, keep_packed: bool
) -> None:
    file = packed(tmp_path / "bag")
    file.with_suffix("").write_bytes(ZstdDecompressor().decompress(file.read_bytes()))
    if not keep_packed:
        file.unlink()
    info = read_info(file.parent)
    assert (info.message_count, info.missing) == (len(SENT), ())


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.95])
def test_a_compressed_file_that_was_cut_gives_what_it_holds(tmp_path: Path, keep: float) -> None:
    def cut_off(plain: bytes) -> bytes:
        whole = ZstdCompressor(level=1).compress(plain)
        return whole[: round(len(whole) * keep)]

    file = packed(tmp_path / "bag", cut_off)
    try:
        messages, missing = salvaged(file)
    except UnreadableFile:
        return
    assert [message.data for message in messages] == SENT[: len(messages)]
    assert missing


@pytest.mark.parametrize("named", [True, False], ids=["with its size", "without"])
def test_a_compressed_file_that_claims_to_be_huge_is_refused(tmp_path: Path, named: bool) -> None:
    def bomb(_: bytes) -> bytes:
        stream = ZstdCompressor().compressobj(size=300 << 20 if named else -1)
        block = bytes(1 << 20)
        return b"".join([*(stream.compress(block) for _ in range(300)), stream.flush()])

    with pytest.raises(UnreadableFile, match=r"more than 256 MiB \(to read it all, set ROBOTCTL"):
        read_info(packed(tmp_path / "bag", bomb))


@pytest.mark.parametrize("content", [b"", b"no frame at all", b"\x28\xb5\x2f\xfd" + bytes(100)])
def test_what_is_no_zstd_is_named(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(UnreadableFile):
        read_info(packed(tmp_path / "bag", lambda _: content))


def test_a_bag_of_the_other_format_is_named_with_its_cure(tmp_path: Path) -> None:
    folder = tmp_path / "my bag"
    folder.mkdir()
    (folder / "bag_0.db3").write_bytes(b"SQLite format 3\0")
    for path in (folder, folder / "bag_0.db3"):
        with pytest.raises(UnreadableFile, match="is a bag in sqlite3 format") as caught:
            read_info(path)
        _, _, cure = str(caught.value).partition(" format: ")
        assert shlex.split(cure) == ["robotctl", "convert", str(path), f"{path.stem}_mcap"]
