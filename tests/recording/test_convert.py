"""A conversion changes the files of a recording, and no message.

Bags that rosbag2 compressed are read; of an sqlite3 bag the command that converts it is told.
"""

from __future__ import annotations

import contextlib
import os
import resource
import shlex
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from zstandard import ZstdCompressor

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.recording import (
    Compression,
    Recording,
    read_info,
    read_messages,
)
from robotctl.recording.convert import ChannelTable, Form, convert
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.listing import list_recording
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.messages import ALWAYS
from robotctl.recording.read.whole_recording import RecordingProof, verify_recording
from robotctl.rerun import Verdict, check_recording
from robotctl.testing.drives import drive, record
from tests.support.bags import SAMPLES, START_NS, data, needs_samples, talk, write_bag
from tests.support.lines import run_python
from tests.support.recordings import (
    Stored,
    Tape,
    keyring,
    metadata_of,
    overwrite,
    read_strictly,
    record_sealed,
    salvaged,
    summary_of,
)

GOLDEN = Path(__file__).parents[1] / "golden"

STORE = get_typestore(Stores.ROS2_JAZZY)
TEXT = "std_msgs/msg/String"
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(9223372036, 854775807),
    QosTime(9223372036, 854775807),
    QosLiveliness.AUTOMATIC,
    QosTime(9223372036, 854775807),
    False,
)

COMPRESS = ZstdCompressor().compress

FORMS = [
    Form(),
    Form(Compression.NONE),
    Form(Compression.LZ4, one_file=True),
    Form(split_bytes=20_000),
]


def text_message(number: int) -> bytes:
    message = STORE.types[TEXT](data=f"message {number} " + "x" * (number % 7))
    return bytes(STORE.serialize_cdr(message, TEXT))


def sqlite_bag(folder: Path, count: int = 50, version: Any = 9, mode: Any = None) -> Path:
    """Return a bag in sqlite3 with two topics."""
    writer = Writer(folder, version=version, storage_plugin=StoragePlugin.SQLITE3)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = [
            writer.add_connection(
                name, TEXT, typestore=STORE, offered_qos_profiles=[LATCHED] if latched else []
            )
            for name, latched in (("/latched", True), ("/plain", False))
        ]
        for number in range(count):
            writer.write(topics[number % 2], START_NS + number * 1000, text_message(number))
    return folder


def data_of(message: Any) -> str:
    return str(message.data)


def contents(path: Path) -> list[tuple[str, int, bytes]]:
    return [(each.topic, each.log_ns, each.data) for each in read_messages(path)]


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("name", ["foreign", "stopped", "killed"])
def test_messages_order_topics_and_metadata_stay(tmp_path: Path, name: str, form: Form) -> None:
    source, target = GOLDEN / name, tmp_path / "copy"
    done = convert(source, target, form)
    assert not done.lost
    assert list(read_messages(target)) == list(read_messages(source))
    before, after = read_info(source), read_info(target)
    assert after.topics == before.topics
    assert after.events == before.events
    assert after.metadata["robotctl.conversion"]["of"]
    ledger, shown = "robotctl.ledger", {"rosbag2", "robotctl.conversion", "robotctl"}
    assert after.metadata.get(ledger) == before.metadata.get(ledger)
    assert set(after.metadata) - shown == set(before.metadata) - shown
    for path in after.files:
        read_strictly(path)
        names = {chunk.compression for chunk in summary_of(path).chunk_indexes}
        assert names == {form.compression.mcap_name}
    with AnyReader([target], default_typestore=STORE) as bag:
        assert bag.message_count == before.message_count


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_a_check_of_the_result_gives_the_same_verdict(tmp_path: Path, form: Form) -> None:
    source = record(tmp_path / "run", drive())
    assert check_recording(source).verdict is Verdict.SAME
    convert(source, tmp_path / "copy", form)
    assert check_recording(tmp_path / "copy").verdict is Verdict.SAME
    convert(source, tmp_path / "copy.mcap", Form(one_file=True))
    assert check_recording(tmp_path / "copy.mcap").verdict is Verdict.SAME


def test_the_result_of_a_sealed_recording_is_whole_and_says_that_it_is_not_sealed(
    tmp_path: Path,
) -> None:
    record_sealed(tmp_path / "run", keyring(tmp_path / "keys"), splits=2)
    assert verify_recording(tmp_path / "run").proof is RecordingProof.SEALED
    convert(tmp_path / "run", tmp_path / "copy", Form())
    found = verify_recording(tmp_path / "copy")
    assert (found.proof, found.wrong) == (RecordingProof.WHOLE, ())
    notes = [note for file in found.files for note in file.seal.notes]
    assert notes == ["it was converted: a seal of the original does not hold for it"] * 3


def test_files_are_split_by_size_and_joined(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", compression=Compression.NONE, chunk_bytes=1 << 12)
    recorder.commands(range(1, 4001))
    recorder.close()
    convert(tmp_path / "run", tmp_path / "split", Form(Compression.NONE, split_bytes=50_000))
    sizes = [path.stat().st_size for path in (tmp_path / "split").glob("*.mcap")]
    assert len(sizes) > 3
    assert max(sizes) < 70_000
    convert(tmp_path / "split", tmp_path / "joined", Form(one_file=True))
    assert [path.name for path in (tmp_path / "joined").iterdir() if path.suffix == ".mcap"] == [
        "joined_0.mcap"
    ]
    assert contents(tmp_path / "joined") == contents(tmp_path / "run")


def test_attachments_and_foreign_metadata_come_along(tmp_path: Path) -> None:
    source = tmp_path / "bag.mcap"
    with source.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("other")
        channel = writer.register_channel("/n", "json", writer.register_schema("n", "", b""))
        writer.add_message(channel, 5, b"{}", 4, 3)
        writer.add_attachment(1, 2, "calibration.yaml", "text/yaml", b"k: 1")
        writer.add_metadata("mine", {"key": "value"})
        writer.finish()
    done = convert(source, tmp_path / "copy", Form())
    assert (done.message_count, done.attachment_count) == (1, 1)
    copy = tmp_path / "copy" / "copy_0.mcap"
    with copy.open("rb") as stream:
        (attachment,) = make_reader(stream).iter_attachments()
    assert (attachment.name, attachment.data) == ("calibration.yaml", b"k: 1")
    assert dict(metadata_of(copy))["mine"] == {"key": "value"}
    assert read_strictly(copy) == [Stored("/n", b"{}", 5, 4, 3)]


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("mode", [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_bag_in_sqlite3_becomes_one_that_every_reader_opens(
    tmp_path: Path, version: int, mode: CompressionMode | None
) -> None:
    bag, target = sqlite_bag(tmp_path / "bag", version=version, mode=mode), tmp_path / "copy"
    done = convert(bag, target, Form())
    assert not done.lost
    names = ("/latched", "/plain")
    sent = [(names[n % 2], START_NS + n * 1000, text_message(n)) for n in range(50)]
    assert contents(target) == sent
    with AnyReader([target]) as reader:
        heard = [
            (connection.topic, time_ns, data_of(reader.deserialize(data, TEXT)))
            for connection, time_ns, data in reader.messages()
        ]
        assert [text[:9] for _, _, text in heard[:2]] == ["message 0", "message 1"]
        qos = {each.topic: each.ext.offered_qos_profiles for each in reader.connections}  # type: ignore[union-attr]
        assert qos == {"/latched": [LATCHED], "/plain": []}
    info = read_info(target)
    assert {each.type_name for each in info.topics} == {TEXT}
    assert {each.definition.splitlines()[-1] for each in info.topics} == {"string data"}


def test_an_old_bag_without_definitions_takes_those_that_are_installed(tmp_path: Path) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    alter(bag, "DROP TABLE message_definitions")
    alter(bag, "UPDATE topics SET type = 'nav_msgs/msg/Odometry', type_description_hash = ''")
    alter(bag, "UPDATE topics SET type_description_hash = 'RIHS01_aa' WHERE name = '/plain'")
    convert(bag, tmp_path / "copy", Form())
    definitions = {each.name: each.definition for each in read_info(tmp_path / "copy").topics}
    assert definitions["/plain"] == ""
    golden = {each.name: each.definition for each in read_info(GOLDEN / "stopped").topics}
    assert definitions["/latched"] == golden["/odom"]


@pytest.mark.parametrize("type_name", ["../../etc/msg/x", "a/msg/b/../c", "no_such/msg/T", ""])
def test_a_type_with_any_name_is_converted_without_a_definition(
    tmp_path: Path, type_name: str
) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    alter(bag, "DROP TABLE message_definitions")
    alter(bag, f"UPDATE topics SET type = '{type_name}'")
    assert convert(bag, tmp_path / "copy", Form()).message_count == 50
    assert {each.definition for each in read_info(tmp_path / "copy").topics} == {""}


def test_odd_rows_are_left_out_and_told(tmp_path: Path) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    alter(bag, "UPDATE messages SET timestamp = -1 WHERE id = 1")
    alter(bag, "UPDATE messages SET data = 7 WHERE id = 2")
    alter(bag, "UPDATE messages SET topic_id = 99 WHERE id = 3")
    done = convert(bag, tmp_path / "copy", Form())
    assert done.message_count == 47
    assert done.lost == ["bag.db3: 3 messages have no valid topic, time or data"]


def test_what_a_damaged_database_still_holds_is_converted_and_the_loss_told(tmp_path: Path) -> None:
    bag = sqlite_bag(tmp_path / "bag", count=3000)
    (path,) = bag.glob("*.db3")
    overwrite(path, path.stat().st_size // 2, b"\xff" * 20_000)
    done = convert(bag, tmp_path / "copy", Form())
    assert 0 < done.message_count < 3000
    assert "the database is damaged after" in done.lost[0]
    assert contents(tmp_path / "copy") == contents(tmp_path / "copy")[: done.message_count]


@pytest.mark.parametrize("content", [b"SQLite format 3\0", b"no database" * 1000])
def test_what_is_no_database_is_named_and_leaves_nothing(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bag.db3"
    path.write_bytes(content)
    with pytest.raises(UnreadableFile, match=r"bag\.db3: it is no bag of rosbag2"):
        convert(path, tmp_path / "copy", Form())
    assert [each.name for each in tmp_path.iterdir()] == ["bag.db3"]


def test_a_view_in_the_place_of_a_table_is_refused(tmp_path: Path) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    alter(bag, "DROP TABLE messages")
    alter(
        bag,
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n",
    )
    with pytest.raises(UnreadableFile, match="no tables of topics and messages"):
        convert(bag, tmp_path / "copy", Form())


@pytest.mark.parametrize("journal", ["DELETE", "WAL"])
def test_reading_a_database_writes_nothing_beside_it(tmp_path: Path, journal: str) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    alter(bag, f"PRAGMA journal_mode={journal}")
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    convert(bag, tmp_path / "copy", Form())
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_what_a_killed_rosbag2_left_in_its_write_ahead_log_is_converted(tmp_path: Path) -> None:
    bag = sqlite_bag(tmp_path / "bag")
    (path,) = bag.glob("*.db3")
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute(
            "INSERT INTO messages SELECT 99, topic_id, timestamp + 1000, data "
            "FROM messages WHERE id = 50"
        )
        database.commit()
        shutil.copytree(bag, tmp_path / "killed", ignore=shutil.ignore_patterns("*-shm"))
    assert [each.name for each in (tmp_path / "killed").glob("*-wal")] == ["bag.db3-wal"]
    done = convert(tmp_path / "killed", tmp_path / "copy", Form())
    assert (done.message_count, done.lost) == (51, [])


def test_more_topics_than_mcap_can_number_are_refused() -> None:
    table = ChannelTable()
    channel = McapChannel(id=0, topic="", message_encoding="", metadata={}, schema_id=0)
    for number in range(1 << 16):
        assert table.add(replace(channel, topic=str(number)), None) == number
    with pytest.raises(UnreadableFile, match="more than 65536 topics: convert them one by one"):
        table.add(replace(channel, topic="one more"), None)


def test_nothing_is_overwritten_and_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    with pytest.raises(Refused, match="File exists: choose another name"):
        convert(GOLDEN / "stopped", tmp_path / "copy", Form())
    program = (
        "import sys\nfrom pathlib import Path\n"
        "from robotctl.recording.convert import convert\n"
        "from robotctl.recording.convert import Form\n"
        "convert(Path(sys.argv[1]), Path(sys.argv[2]), Form())\n"
    )
    ran = run_python(
        program,
        GOLDEN / "stopped",
        tmp_path / "full",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # the limit would cut the caches
    )
    assert "File too large: raise the limit of file sizes" in ran.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["copy"]


@needs_samples
def test_the_bags_of_the_real_rosbag2_are_converted(tmp_path: Path) -> None:
    for bag in SAMPLES.iterdir():
        done = convert(bag, tmp_path / bag.name, Form(one_file=True))
        assert not done.lost
        assert list(read_messages(tmp_path / bag.name)) == list(read_messages(bag))


def alter(bag: Path, statement: str) -> None:
    """Change the database of a bag."""
    (path,) = bag.glob("*.db3")
    with sqlite3.connect(path) as database:
        database.execute(statement)
    database.close()


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
        writer = McapWriter(stream, chunk_size=1000)
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


def packed(folder: Path, content: Callable[[bytes], bytes] = COMPRESS) -> Path:
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


def test_a_file_that_is_missing_is_told(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "foreign", tmp_path / "run")
    next((tmp_path / "run").glob("*_1.mcap")).unlink()
    done = convert(tmp_path / "run", tmp_path / "copy", Form())
    assert done.message_count == 97
    assert "metadata.yaml names it, but it is not there" in done.lost[0]


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
