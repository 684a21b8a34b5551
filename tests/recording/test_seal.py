"""A sealed recording cannot be changed unseen; a seal that fails stops nothing.

A copy of a sealed file says "repaired": it forges no link, and keeps its place in the chain.
"""

from __future__ import annotations

import json
import shutil
import stat
import struct
from pathlib import Path

import pytest
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from robotctl.base.paths import seal_folder
from robotctl.decisions.journal import files_of, log_folder
from robotctl.recording import Compression, read_messages
from robotctl.recording.format.seal_records import LINK_OPCODE, Link, LinkKind, Opening, SealOfFile
from robotctl.recording.keep.recover import recover
from robotctl.recording.keep.repair import repair
from robotctl.recording.read.records import InputFile
from robotctl.recording.read.whole_file import SealState, WholeFile, read_whole_file
from robotctl.recording.read.whole_recording import (
    RecordingProof,
    check_chain,
    find_head,
    verify_recording,
)
from robotctl.recording.seal import KEY_FILE, Keyring, SigningKey, is_signed, known_heads
from robotctl.recording.write import mcap_writer
from tests.support.recordings import Tape, flip, keyring, read_strictly, record_sealed


@pytest.fixture(autouse=True)
def _a_link_at_each_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_writer, "LINK_PERIOD_S", 0.0)


@pytest.fixture
def keys(tmp_path: Path) -> Keyring:
    return keyring(tmp_path / "keys")


def sealed(path: Path) -> tuple[WholeFile, ...]:
    return verify_recording(path).files


def test_a_finished_recording_is_sealed_and_every_reader_opens_it(
    tmp_path: Path, keys: Keyring
) -> None:
    (file,) = record_sealed(tmp_path / "run", keys)
    found = verify_recording(tmp_path / "run")
    assert (found.proof, found.wrong) == (RecordingProof.SEALED, ())
    assert len(found.files[0].seal.links) > 2
    assert len(read_strictly(file)) == len(list(read_messages(tmp_path / "run"))) == 199
    with file.open("rb") as stream:  # as a stream, skipping what is not known
        names = [r.name for r in StreamReader(stream).records if isinstance(r, Metadata)]
    assert "robotctl.ledger" in names


def test_the_chain_runs_over_splits_and_restarts(tmp_path: Path, keys: Keyring) -> None:
    files = record_sealed(tmp_path / "one", keys, splits=2)
    files += record_sealed(tmp_path / "two", Keyring(tmp_path / "keys", "robot"))
    found = [file for path in files for file in sealed(path)]
    assert [file.seal.state for file in found] == [SealState.SEALED] * 4
    openings = [file.seal.opening for file in found]
    assert [opening.number for opening in openings if opening] == [1, 2, 3, 4]
    chain = check_chain(found)
    assert (chain.wrong, chain.absent) == ([], [])


def test_a_missing_file_is_a_gap_and_a_forged_one_breaks_the_chain(
    tmp_path: Path, keys: Keyring
) -> None:
    files = record_sealed(tmp_path / "run", keys, splits=2)
    found = [file for path in files for file in sealed(path)]
    assert "file 2 is not here" in check_chain([found[0], found[2]]).absent[0]
    shutil.copytree(tmp_path / "keys", tmp_path / "stolen")
    forged = Keyring(tmp_path / "stolen", "robot")
    (other,) = record_sealed(tmp_path / "forged", forged)
    opening = sealed(other)[0].seal.opening
    assert opening is not None
    assert opening.number == 4  # the stolen key signs what comes, not what was
    assert check_chain([*found, *sealed(other)]).wrong == []


def test_who_steals_the_present_key_cannot_sign_for_yesterday(
    tmp_path: Path, keys: Keyring
) -> None:
    record_sealed(tmp_path / "run", keys, splits=1)
    stored = keys.load()
    assert stored is not None
    first = sealed(tmp_path / "run")[0].seal
    assert first.opening is not None
    assert SigningKey(bytes.fromhex(stored.seed)).public not in (
        first.opening.key,
        first.opening.previous_key,
    )


def test_the_old_private_key_is_overwritten_on_the_disk(tmp_path: Path, keys: Keyring) -> None:
    keys.rotate()
    path = tmp_path / "keys" / KEY_FILE
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with path.open("rb") as old:
        seed = json.loads(old.read())["seed"].encode()
        keys.open_file("run_0.mcap")
        old.seek(0)
        assert seed not in old.read()
    assert seed not in path.read_bytes()


def edit_consistently(path: Path) -> None:
    """Change a message of an uncompressed file, and make every checksum right again."""
    data = bytearray(path.read_bytes())
    chunk = min(read_whole_file(path).data.listed[Opcode.CHUNK_INDEX])
    (length,) = struct.unpack_from("<Q", data, chunk + 1)
    head = 9 + 8 + 8 + 8 + 4 + 4 + 8
    end = chunk + 9 + length
    data[end - 1] ^= 1
    struct.pack_into("<I", data, chunk + 9 + 24, crc32(data[chunk + head : end]))
    path.write_bytes(data)
    data_end = read_whole_file(path).data.end
    struct.pack_into("<I", data, data_end + 9, crc32(data[:data_end]))
    path.write_bytes(data)


def test_a_consistent_edit_is_found_by_the_seal_alone(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys, compression=Compression.NONE)
    assert sealed(file)[0].seal.state is SealState.SEALED
    edit_consistently(file)
    found = verify_recording(file)
    assert found.flaws == ()
    assert found.files[0].seal.state is SealState.BROKEN
    assert "the chain is broken" in found.wrong[0]


def test_another_opening_is_not_signed_by_the_key_before(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys)
    flip(file, file.read_bytes().index(b'"robot":"robot"') + 10, 1)
    (sentence,) = (text for text in sealed(file)[0].seal.wrong if "file before" in text)
    assert "not signed" in sentence


def test_the_place_of_a_change_is_told_between_two_links(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys, compression=Compression.NONE)
    links = sealed(file)[0].seal.links
    at = links[1].covered + 300
    flip(file, at, 1)
    found = sealed(file)[0].seal
    assert found.links == links[:2]
    text = found.wrong[0]
    start, end = (int(word.rstrip(":")) for word in text.split() if word.rstrip(":").isdigit())
    assert start <= at < end


def test_a_tail_that_was_cut_is_found_by_a_later_head(tmp_path: Path, keys: Keyring) -> None:
    first, second = record_sealed(tmp_path / "run", keys, splits=1)
    whole = sealed(first)[0]
    assert whole.seal.head is not None
    head = whole.seal.head.digest.hex()
    stored = keys.load()
    assert stored is not None
    assert find_head([whole, *sealed(second)], stored.head.digest) is not None
    whole.seal.links.pop()
    assert find_head([whole], head) is None
    assert "tail was cut" in check_chain([whole, *sealed(second)]).wrong[0]


def test_what_is_known_of_heads_outlives_the_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    keys = Keyring(seal_folder("robot"), "robot")
    files = record_sealed(tmp_path / "run", keys, splits=1)
    heads = known_heads()
    for file in files:
        seal = sealed(file)[0].seal
        assert seal.opening is not None
        assert heads.opened[seal.opening.key] == seal.opening
        assert seal.knows(heads.closed[seal.opening.key].digest)
    (journal,) = files_of(log_folder("robot"))
    assert "seed" not in journal.read_text()


def test_a_rotation_begins_a_new_chain_at_the_next_file(tmp_path: Path, keys: Keyring) -> None:
    (one,) = record_sealed(tmp_path / "one", keys)
    before = keys.load()
    after = keys.rotate()
    (two,) = record_sealed(tmp_path / "two", keys)
    assert before is not None
    assert before.root != after.root
    roots = [
        file.seal.opening.root for path in (one, two) for file in sealed(path) if file.seal.opening
    ]
    assert roots == [before.root, after.root]
    assert verify_recording(two).proof is RecordingProof.SEALED


class FailingSealer:
    """A sealer that fails at one of its steps."""

    def __init__(self, keys: Keyring, step: str) -> None:
        self._keys = keys
        self._step = step

    def open_file(self, file: str) -> SealOfFile:
        if self._step == "open":
            raise OSError("the state folder is read-only")
        opened = self._keys.open_file(file)
        return SealOfFile(opened.opening, self._sign) if self._step == "sign" else opened

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        raise OSError("no space")

    def _sign(self, data: bytes) -> bytes:
        raise ValueError("no signature")


@pytest.mark.parametrize("step", ["open", "sign", "keep"])
def test_a_seal_that_fails_never_stops_the_recording_and_is_told(
    tmp_path: Path, keys: Keyring, step: str
) -> None:
    recorder = Tape(tmp_path / "run", sealer=FailingSealer(keys, step), may_fail=True)
    recorder.commands(range(100))
    stats = recorder.close()
    assert not recorder.failures
    assert (stats.written, stats.dropped) == (100, 0)
    assert "not sealed" in stats.warning
    assert len(list(read_messages(tmp_path / "run"))) == 100


def test_a_damaged_key_is_told_and_not_replaced(tmp_path: Path, keys: Keyring) -> None:
    keys.rotate()
    path = tmp_path / "keys" / KEY_FILE
    path.write_text("{}")
    with pytest.raises(ValueError, match="damaged"):
        keys.open_file("run_0.mcap")
    assert path.read_text() == "{}"


def test_a_repair_says_so_and_forges_no_link(tmp_path: Path, keys: Keyring) -> None:
    recorder = Tape(tmp_path / "runs" / "run", sealer=keys, chunk_bytes=1024, flush_s=0.005)
    recorder.commands(range(1, 200))
    recorder.settle()
    file = recorder.stats().file
    killed = file.read_bytes()
    recorder.close()
    file.write_bytes(killed)
    assert len(list(repair(tmp_path / "runs"))) == 1
    found = verify_recording(tmp_path / "runs" / "run")
    (seal,) = [each.seal for each in found.files]
    assert seal.opening is not None
    assert (found.proof, found.wrong, seal.state) == (RecordingProof.WHOLE, (), SealState.PARTLY)
    assert any("a repair has written the rest" in note for note in seal.notes)
    assert all(is_signed(each.signed(), each.signature, seal.opening.key) for each in seal.links)


def links_in(path: Path) -> list[Link]:
    """Return all links in the data of a file, signed or not."""
    with InputFile(path) as file:
        private = read_whole_file(path).data.private
        return [Link.read(file.content(each)) for each in private if each.opcode == LINK_OPCODE]


def test_a_recovered_file_says_repaired_and_forges_no_link(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys)
    original = sealed(file)[0].seal
    copy = tmp_path / "copy.mcap"
    recover(file, copy)
    found = verify_recording(copy)
    seal = found.files[0].seal
    assert (found.proof, found.wrong, seal.state) == (RecordingProof.WHOLE, (), SealState.NONE)
    assert seal.notes == ["a repair copied it from a sealed file: nothing in it is signed"]
    assert seal.opening == original.opening
    assert original.head is not None
    (link,) = links_in(copy)
    assert (link.kind, link.covered) == (LinkKind.REPAIRED, 0)
    assert link.digest == original.head.digest
    assert link.signature == bytes(64)
    recover(copy, tmp_path / "of_the_copy.mcap")
    (again,) = links_in(tmp_path / "of_the_copy.mcap")
    assert (again.digest, again.number) == (link.digest, link.number)
    assert verify_recording(tmp_path / "of_the_copy.mcap").wrong == ()


def test_a_torn_file_that_a_repair_replaced_keeps_its_place_in_the_chain(
    tmp_path: Path, keys: Keyring
) -> None:
    run = tmp_path / "runs" / "run"
    files = record_sealed(run, keys, splits=2)
    torn = files[1]
    torn.write_bytes(torn.read_bytes()[: torn.stat().st_size * 2 // 3])
    (note,) = repair(tmp_path / "runs")
    assert "was torn" in note.text
    found = verify_recording(run)
    assert (found.proof, found.wrong, found.chain.absent) == (RecordingProof.WHOLE, (), [])
    states = [file.seal.state for file in found.files]
    assert states == [SealState.SEALED, SealState.NONE, SealState.SEALED]
    assert found.files[1].seal.is_copy


def test_a_copy_of_another_file_breaks_the_chain(tmp_path: Path, keys: Keyring) -> None:
    """Its opening is not the one that the files around it know."""
    first, second, third = record_sealed(tmp_path / "run", keys, splits=2)
    others = keyring(tmp_path / "others")
    foreign = record_sealed(tmp_path / "other", others, splits=1)[1]
    recover(foreign, tmp_path / "copy.mcap")
    files = [sealed(path)[0] for path in (first, tmp_path / "copy.mcap", third)]
    assert check_chain(files).absent == [
        f"file 2 is not here, between {first.name} and {third.name}"
    ]
    assert second.exists()
