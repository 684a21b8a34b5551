"""The bytes of a recording and its seal, as a part of its check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from robotctl.errors import UnreadableFile
from robotctl.recording.read.files import recording_files
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.verified import VerifiedRecording, verify_recording
from robotctl.recording.read.whole_file import WholeFileReading
from robotctl.rerun.check_report import Report

ALL_BYTES_BELOW: Final = 100_000_000
"""A recording below this size [bytes] is always read completely; that takes a second."""

_KEY_DIGITS = 16


@dataclass(frozen=True, slots=True)
class BytesFound:
    """What reading every byte has found: a sentence for each flaw, and the seal in one line."""

    flaws: list[str]
    seal: str


def read_bytes(
    path: Path, begun: Mapping[Path, WholeFileReading] = MappingProxyType({})
) -> BytesFound | None:
    """Read every byte of a recording, on in the files that are `begun`.

    None if it cannot be read at all.
    """
    try:
        found = verify_recording(path, begun=begun)
    except (OSError, UnreadableFile):
        return None
    return BytesFound([*found.whole.unreadable, *found.whole.wrong], _seal_line(found))


def is_small(path: Path) -> bool:
    """Return whether every byte of a recording is read in any case.

    Raises:
        OSError, UnreadableFile: There is no recording.
    """
    return sum(file.stat().st_size for file in recording_files(path)) < ALL_BYTES_BELOW


def check_bytes(
    path: Path, report: Report, *, all_bytes: bool, found: BytesFound | None = None
) -> None:
    """Read every byte of the recording `path`, if it is small or `all_bytes` is set.

    What is wrong is noted as missing from the check: it cannot tell what was recorded there. The
    seal is told, and changes no verdict. `found` is given if another process has read the bytes.
    """
    try:
        if not all_bytes and not is_small(path):
            report.notes.append("not every byte was read: --all-bytes reads them all")
            return
    except (OSError, UnreadableFile):
        return  # the check has told why
    found = found or read_bytes(path)
    if found is None:
        return
    for sentence in found.flaws:
        if sentence not in report.missing:
            report.miss(sentence)
    report.seal = found.seal


def _seal_line(found: VerifiedRecording) -> str:
    """Return what the seals prove in one line, "" without a seal."""
    states = [file.seal.state for file in found.files]
    if set(states) <= {SealState.NONE}:
        return ""
    broken = next((sentence for file in found.files for sentence in file.seal.wrong), "")
    if broken or found.chain.wrong:
        return f"broken: {broken or found.chain.wrong[0]}"
    sealed = states.count(SealState.SEALED)
    opening = next(file.seal.opening for file in found.files if file.seal.opening is not None)
    extent = "whole" if sealed == len(states) else f"{sealed} of {len(states)} files whole"
    return f"{extent}, unbroken, by {opening.robot}'s key {opening.root[:_KEY_DIGITS]}"
