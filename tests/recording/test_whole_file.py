"""A recording whose bytes or counts are not as they were written is found, with the place."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.base.errors import UnreadableFile
from robotctl.recording import Compression
from robotctl.recording.read.whole_data import FileState
from robotctl.recording.read.whole_file import find_flip, read_whole_file
from robotctl.recording.read.whole_recording import verify_recording
from robotctl.testing.drives import ODOMETRY, TWIST
from tests.support.cases import for_each
from tests.support.recordings import Tape, write_numbered

GOLDEN = Path(__file__).parents[1] / "golden"


def record(folder: Path, compression: Compression, splits: int = 0) -> Path:
    """Return a finished recording of two topics."""
    recorder = Tape(
        folder, compression=compression, chunk_bytes=1 << 13, metadata=lambda: {"robot": "robot"}
    )
    twist, odometry = recorder.add_topic(TWIST), recorder.add_topic(ODOMETRY)
    for part in range(splits + 1):
        write_numbered(recorder, twist, range(1000 * part, 1000 * part + 300))
        write_numbered(recorder, odometry, range(1000 * part, 1000 * part + 40), 700)
        if part < splits:
            recorder.split()
    recorder.close()
    return folder


@pytest.fixture(scope="module", params=list(Compression))
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp(request.param.value) / "run", request.param)


def only_file(folder: Path) -> Path:
    (file,) = folder.glob("*.mcap")
    return file


def flip_bits(whole: bytes, path: Path, count: int, seed: int) -> None:
    """Check that each of `count` single flipped bits is found, and its byte is named."""
    dice = random.Random(seed)
    for _ in range(count):
        bit = dice.randrange(8 * len(whole))
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            found = read_whole_file(path)
        except UnreadableFile:
            assert bit // 8 < 64, bit  # it is no MCAP file any more
            continue
        assert not found.whole, bit
        places = [range(flaw.start, flaw.end) for flaw in found.flaws.kept]
        named = any(bit // 8 in place for place in places)
        assert named or found.data.unread, (bit, found.flaws.kept)


def test_each_of_60_random_flips_is_found_and_its_byte_is_named(
    finished: Path, tmp_path: Path
) -> None:
    flip_bits(only_file(finished).read_bytes(), tmp_path / "flipped.mcap", 30, seed=7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stopped", "killed"])
def test_each_of_1000_random_flips_is_found_and_its_byte_is_named(
    tmp_path: Path, name: str
) -> None:
    whole = only_file(GOLDEN / name).read_bytes()
    flip_bits(whole, tmp_path / "flipped.mcap", 1000, seed=8)


def test_every_bit_of_the_end_is_protected(finished: Path, tmp_path: Path) -> None:
    whole = only_file(finished).read_bytes()
    path = tmp_path / "flipped.mcap"
    for at in range(len(whole) - 60, len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        assert not read_whole_file(path).whole, at


def test_a_flip_is_located_by_the_checksum_alone() -> None:
    from zlib import crc32

    data = bytearray(random.Random(2).randbytes(5000))
    told = crc32(data)
    for at in (0, 1, 2500, 4999):
        data[at] ^= 0x20
        assert find_flip(told, crc32(data), len(data)) == at
        data[at] ^= 0x20
    data[3] ^= 1
    data[4000] ^= 1
    assert find_flip(told, crc32(data), len(data)) is None


@for_each("name", ["stopped", "killed", "foreign"])
def test_recordings_of_the_version_before_are_whole(name: str) -> None:
    found = verify_recording(GOLDEN / name)
    assert (found.wrong, found.unreadable) == ((), ())


def test_a_recording_of_several_files_is_whole_until_one_is_missing(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", Compression.ZSTD, splits=2)
    found = verify_recording(folder)
    assert (found.wrong, found.unreadable) == ((), ())
    assert [file.state for file in found.files] == [FileState.FINISHED] * 3
    (folder / "run_1.mcap").unlink()
    assert "run_1.mcap" in verify_recording(folder).unreadable[0]


def test_a_recording_that_is_still_written_is_whole(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", metadata=lambda: {"robot": "r"})
    recorder.commands(range(100))
    try:
        found = verify_recording(tmp_path / "run")
    finally:
        recorder.close()
    assert (found.wrong, found.unreadable) == ((), ())
    assert [file.state for file in found.files] == [FileState.LIVE]


@pytest.mark.parametrize(
    "change",
    [lambda data: data[:-1], lambda data: data + b"\0", lambda data: data + data[-37:]],
    ids=["cut", "appended", "a second end"],
)
def test_what_lies_behind_the_end_and_what_is_missing_there_is_found(
    finished: Path, tmp_path: Path, change: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "changed.mcap"
    path.write_bytes(change(only_file(finished).read_bytes()))
    assert read_whole_file(path).flaws.count


@pytest.mark.parametrize("splits", [0, 1])
def test_counts_of_metadata_yaml_that_contradict_the_files_are_found(
    tmp_path: Path, splits: int
) -> None:
    folder = record(tmp_path / "run", Compression.ZSTD, splits)
    yaml = folder / "metadata.yaml"
    text = yaml.read_text()
    for match in re.finditer(r"message_count: (\d+)", text):
        yaml.write_text(f"{text[: match.start(1)]}{int(match[1]) + 1}{text[match.end(1) :]}")
        assert verify_recording(folder).wrong, match.start()
