"""The bytes of a recording and its seal, as a part of its check."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from robotctl.errors import UnreadableFile
from robotctl.recording.read.files import recording_files
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.verified import VerifiedRecording, verify_recording
from robotctl.rerun.check_report import Report

ALL_BYTES_BELOW: Final = 100_000_000
"""A recording below this size [bytes] is always read completely; that takes a second."""

_KEY_DIGITS = 16


def is_small(path: Path) -> bool:
    """Return whether every byte of a recording is read in any case.

    Raises:
        OSError, UnreadableFile: There is no recording.
    """
    return sum(file.stat().st_size for file in recording_files(path)) < ALL_BYTES_BELOW


def check_bytes(path: Path, report: Report, *, all_bytes: bool) -> None:
    """Read every byte of the recording `path`, if it is small or `all_bytes` is set.

    What is wrong is noted as missing from the check: it cannot tell what was recorded there. The
    seal is told, and changes no verdict.
    """
    try:
        if not all_bytes and not is_small(path):
            report.notes.append("not every byte was read: --all-bytes reads them all")
            return
        found = verify_recording(path)
    except (OSError, UnreadableFile):
        return  # the check has told why
    for sentence in (*found.whole.unreadable, *found.whole.wrong):
        if sentence not in report.missing:
            report.miss(sentence)
    report.seal = _seal_line(found)


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
