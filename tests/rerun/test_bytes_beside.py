"""A check that reads every byte unpacks each chunk once, and tells what it finds as afterwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording.read import stored_chunk
from robotctl.recording.read.decompression import decompressor_of
from robotctl.recording.read.whole_file import WholeFileReading
from robotctl.rerun import check
from robotctl.rerun.check_report import Report, Verdict
from tests.support.edited_recordings import write_contents
from tests.support.heard_drives import heard_drive


def unpacked_in(
    path: Path, monkeypatch: pytest.MonkeyPatch, *, beside: bool
) -> tuple[list[bytes], Report]:
    """Return the stored bytes of each chunk that a check of `path` unpacks, and its report."""
    unpacked: list[bytes] = []

    def noted(name: str) -> Any:
        unpack = decompressor_of(name)

        def note(stored: bytes, size: int) -> bytes:
            unpacked.append(stored)
            return unpack.unpack(stored, size)

        return unpack._replace(unpack=note)

    with monkeypatch.context() as patched:
        patched.setattr(stored_chunk, "decompressor_of", noted)
        if not beside:
            patched.setattr(check, "bytes_beside", lambda *_, **__: None)
        report = check.check_recording(path)
    return unpacked, replace(report, took_s=0.0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_contents(tmp_path / "run", heard_drive(tmp_path / "drive"))


def test_each_chunk_is_unpacked_once(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked, report = unpacked_in(recording, monkeypatch, beside=True)
    twice, afterwards = unpacked_in(recording, monkeypatch, beside=False)
    assert len(unpacked) == len(set(unpacked)) > 1
    assert sorted(twice) == sorted([*unpacked, *unpacked])
    assert report == afterwards
    assert report.verdict is Verdict.SAME


def test_a_flipped_bit_is_told_as_it_is_afterwards(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (file,) = recording.glob("*.mcap")
    whole = file.read_bytes()
    for at in range(len(whole) // 40, len(whole), len(whole) // 40):
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :])
        _, beside = unpacked_in(recording, monkeypatch, beside=True)
        _, afterwards = unpacked_in(recording, monkeypatch, beside=False)
        assert repr(beside) == repr(afterwards)
        assert beside.verdict is not Verdict.SAME


def test_a_failing_reading_beside_is_repeated(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object) -> None:
        raise OSError

    _, expected = unpacked_in(recording, monkeypatch, beside=False)
    monkeypatch.setattr(WholeFileReading, "read_past", failing)
    _, report = unpacked_in(recording, monkeypatch, beside=True)
    assert report == expected
