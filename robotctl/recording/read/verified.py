"""Whether a recording is whole and sealed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.seal_chain import Chain, SealedFile, check_chain
from robotctl.recording.read.seal_check import SealState, check_seal
from robotctl.recording.read.whole_recording import WholeRecording, read_whole_recording


class RecordingProof(StrEnum):
    """What is proved of a recording, the gravest first."""

    BROKEN = "broken"
    """A byte, a count, the chain or a signature is wrong."""

    UNREADABLE = "unreadable"
    """Not everything could be read."""

    WHOLE = "whole"
    """All bytes belong together, but who wrote them is not proved for all."""

    SEALED = "sealed"


@dataclass(frozen=True, slots=True)
class VerifiedRecording:
    """A recording that was read completely, and its seals."""

    whole: WholeRecording
    files: tuple[SealedFile, ...]
    chain: Chain

    @property
    def wrong(self) -> tuple[str, ...]:
        """A sentence for everything that is wrong: bytes, counts, seals, chain."""
        many = len(self.whole.files) > 1
        seals = [
            f"{file.path.name}: {sentence}" if many else sentence
            for file in self.files
            for sentence in file.seal.wrong
        ]
        return (*self.whole.wrong, *seals, *self.chain.wrong)

    @property
    def proof(self) -> RecordingProof:
        """The gravest that was found."""
        if self.wrong:
            return RecordingProof.BROKEN
        if self.whole.unreadable:
            return RecordingProof.UNREADABLE
        sealed = all(file.seal.state is SealState.SEALED for file in self.files)
        return RecordingProof.SEALED if sealed else RecordingProof.WHOLE


def verify_recording(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> VerifiedRecording:
    """Read every byte of a recording, and check its seals.

    `on_progress` gets bytes done and in total.

    Raises:
        UnreadableFile: `path` holds no MCAP file, or the disk fails.
    """
    whole = read_whole_recording(path, on_progress)
    files = []
    for file in whole.files:
        try:
            with InputFile(file.path) as opened:
                seal = check_seal(opened, file)
        except (OSError, Damaged) as error:
            raise UnreadableFile(f"{file.path} cannot be read: {error}") from error
        files.append(SealedFile(file.path, file.state, seal))
    return VerifiedRecording(whole, tuple(files), check_chain(files))
