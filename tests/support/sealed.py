"""Sealed recordings for tests: a link at each commit, and keys in a temporary folder."""

from __future__ import annotations

from pathlib import Path

from robotctl.recording import Compression, Recorder, RecorderOptions
from robotctl.recording.format.seal_records import Link, Opening, SealOfFile
from robotctl.recording.seal.keyring import Keyring
from robotctl.recording.seal.signatures import SEED_BYTES, SigningKey
from robotctl.recording.write.file_seal import Sealer
from robotctl.testing.drives import TWIST
from tests.support.recordings import write_numbered


class Forger:
    """Seals a file under the opening of another one, without its private key."""

    def __init__(self, opening: Opening) -> None:
        self._opening = opening
        self._key = SigningKey(bytes(SEED_BYTES))

    def open_file(self, file: str) -> SealOfFile:
        """Claim to be the original."""
        return SealOfFile(self._opening, self._key.sign)

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Keep nothing: the robot's list of heads is out of reach."""


def keyring(folder: Path, robot: str = "robot") -> Keyring:
    """Return the keys of a robot in `folder`, which is created."""
    folder.mkdir(mode=0o700, exist_ok=True)
    return Keyring(folder, robot)


def record_sealed(
    folder: Path, sealer: Sealer, *, splits: int = 0, compression: Compression = Compression.ZSTD
) -> list[Path]:
    """Record messages in several files; return them."""
    options = RecorderOptions(sealer=sealer, compression=compression, chunk_bytes=1 << 12)
    recorder = Recorder(folder, options, metadata=lambda: {"robot": "robot"}, on_failure=print)
    channel = recorder.add_topic(TWIST)
    for part in range(splits + 1):
        write_numbered(recorder, channel, range(1000 * part + 1, 1000 * part + 200))
        if part < splits:
            recorder.split()
    recorder.close()
    return sorted(folder.glob("*.mcap"))
