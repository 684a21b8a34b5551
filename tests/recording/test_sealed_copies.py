"""A copy of a sealed file says "repaired": it forges no link, and keeps its place in the chain."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.recording import Recorder
from robotctl.recording.format.seal_records import LINK_OPCODE, Link, LinkKind
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.keep.repair import repair
from robotctl.recording.read.mcap_input import RECORD_HEAD, InputFile
from robotctl.recording.read.seal_chain import SealedFile, check_chain
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.whole_file import read_whole_file
from robotctl.recording.read.whole_recording import RecordingProof, verify_recording
from robotctl.recording.seal.keyring import Keyring
from robotctl.recording.write import file_seal
from robotctl.testing.drives import TWIST
from tests.support.recordings import keyring, record_sealed, write_numbered


@pytest.fixture(autouse=True)
def _a_link_at_each_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_seal, "LINK_PERIOD_S", 0.0)


@pytest.fixture
def keys(tmp_path: Path) -> Keyring:
    return keyring(tmp_path / "keys")


def the_file(path: Path) -> SealedFile:
    (file,) = verify_recording(path).files
    return file


def links_in(path: Path) -> list[Link]:
    """Return all links in the data of a file, signed or not."""
    with InputFile(path) as file:
        private = read_whole_file(path).data.private
        return [
            Link.read(file.read(offset + RECORD_HEAD.size, length))
            for opcode, offset, length in private
            if opcode == LINK_OPCODE
        ]


def test_a_recovered_file_says_repaired_and_forges_no_link(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys)
    original = the_file(file).seal
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


def test_a_copy_of_a_copy_says_the_same(tmp_path: Path, keys: Keyring) -> None:
    (file,) = record_sealed(tmp_path / "run", keys)
    for source, target in ((file, "one.mcap"), (tmp_path / "one.mcap", "two.mcap")):
        recover(source, tmp_path / target)
    (one,), (two,) = links_in(tmp_path / "one.mcap"), links_in(tmp_path / "two.mcap")
    assert (one.digest, one.number) == (two.digest, two.number)
    assert verify_recording(tmp_path / "two.mcap").wrong == ()


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


def test_a_copy_beside_its_original_takes_no_place_in_the_chain(
    tmp_path: Path, keys: Keyring
) -> None:
    run = tmp_path / "run"
    record_sealed(run, keys, splits=2)
    recover_folder(run, tmp_path / "copy")
    originals, copies = verify_recording(run), verify_recording(tmp_path / "copy")
    assert (copies.proof, copies.wrong, copies.chain.absent) == (RecordingProof.WHOLE, (), [])
    both = check_chain([*copies.files, *originals.files])
    assert (both.wrong, both.absent) == ([], [])


def test_a_copy_of_another_file_breaks_the_chain(tmp_path: Path, keys: Keyring) -> None:
    """Its opening is not the one that the files around it know."""
    first, second, third = record_sealed(tmp_path / "run", keys, splits=2)
    others = keyring(tmp_path / "others")
    foreign = record_sealed(tmp_path / "other", others, splits=1)[1]
    recover(foreign, tmp_path / "copy.mcap")
    files = [the_file(path) for path in (first, tmp_path / "copy.mcap", third)]
    assert check_chain(files).absent == [
        f"file 2 is not here, between {first.name} and {third.name}"
    ]
    assert second.exists()


def test_a_copy_of_a_file_without_a_seal_has_none(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 20))
    recorder.close()
    (file,) = (tmp_path / "run").glob("*.mcap")
    recover(file, tmp_path / "copy.mcap")
    assert links_in(tmp_path / "copy.mcap") == []
    assert the_file(tmp_path / "copy.mcap").seal.opening is None
