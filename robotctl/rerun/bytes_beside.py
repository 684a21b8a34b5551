"""Reads every byte of a recording beside its check, so that each chunk is unpacked once."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from robotctl.errors import UnreadableFile
from robotctl.recording import Recording
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.messages import OpenFile
from robotctl.recording.read.topic_places import Spot
from robotctl.recording.read.whole_file import WholeFileReading
from robotctl.rerun.bytes_check import BytesFound, is_small, read_bytes
from robotctl.store.store_path import StorePath

_FAILURES = (OSError, Damaged, UnreadableFile)
"""What ends the reading of a file here: it is read again on its own, which tells why."""


class BytesBeside:
    """The reading of the files of a recording, each as far as the check is.

    A file that a process writes is left out.
    """

    def __init__(self, recording: Recording) -> None:
        self._path = recording.path
        self._files: Sequence[OpenFile] = recording.open_files
        self._readings: dict[int, WholeFileReading | None] = {}

    def enter(self, spot: Spot) -> None:
        """Read up to a place that the check reads next, and keep its chunk for it."""
        if spot.file not in self._readings:
            for before in self._files[: spot.file]:
                before.file.kept = None
            self._readings[spot.file] = _begun(self._files[spot.file])
        reading = self._readings[spot.file]
        if reading is None:
            return
        try:
            reading.read_past(spot.offset)
        except _FAILURES:
            self._readings[spot.file] = None

    def found(self) -> BytesFound | None:
        """Read the rest, and return what was found; None if the recording cannot be read."""
        begun = {
            self._files[number].path: reading
            for number, reading in self._readings.items()
            if reading is not None
        }
        return read_bytes(self._path, begun)


def bytes_beside(recording: Recording, *, all_bytes: bool) -> BytesBeside | None:
    """Return what reads every byte beside a check, None if not every byte here is read."""
    if isinstance(recording.path, StorePath):
        return None
    with suppress(OSError, UnreadableFile):
        return BytesBeside(recording) if all_bytes or is_small(recording.path) else None
    return None


def _begun(each: OpenFile) -> WholeFileReading | None:
    with suppress(*_FAILURES):
        return None if each.file.is_changing() else WholeFileReading(each.file)
    return None
