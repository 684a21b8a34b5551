"""The recordings that `sync` copies, in a folder or below a URL."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import Final, Self

from robotctl.base.errors import Divergence, UnreadableFile
from robotctl.base.store import open_store
from robotctl.base.store.objects import ObjectStore, StoredObject, hash_in, without_hashes
from robotctl.base.text import printable
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.disk import is_locked, reason_of
from robotctl.recording.format.names import INDEX_FILE, natural_order
from robotctl.recording.format.records import MAGIC
from robotctl.recording.format.rosbag2 import METADATA_FILE
from robotctl.recording.keep.listing import CLIPS_FOLDER, is_own

SUFFIX: Final = ".mcap"

REPLACED: Final = (METADATA_FILE, INDEX_FILE)
"""Generated files, of which a newer one replaces an older copy."""

YOUNG_NS: Final = 60 * NS_PER_S
"""Time without a change after which an unlocked file without an end is finished."""

OF_THE_SYSTEM: Final = "lost+found"
"""A folder at the top of many disks that only root can read."""

PIECE_BYTES: Final = 1 << 18
STORED_PIECE_BYTES: Final = 8 << 20

_PLAIN: Final = re.compile(r"[A-Za-z0-9_+=@-][A-Za-z0-9_.+=@-]*")
"""Names that are the same in every store, shell, URL and file system."""

_RENAME: Final = "rename it: letters, digits and _ . + = @ - only"

_DEPTH: Final = 3
"""The number of parts of the longest key, RECORDING/clips/FILE."""

Pace = Callable[[int], None]
"""Called with the number of bytes to send or read back next, 0 between local reads; may sleep."""


class FileChanged(UnreadableFile):
    """A file changed while it was read."""


class WrongContent(Divergence):
    """The content of an object in a store differs from the local file, or from its own hash."""


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A local file to copy to a store under `key`."""

    key: str
    path: Path
    size_bytes: int
    modified_ns: int

    @classmethod
    def of(cls, key: str, path: Path, status: os.stat_result) -> Self:
        """Return the file at `path`, with the size and the mtime in its stat `status`."""
        return cls(key, path, status.st_size, status.st_mtime_ns)

    def sha256(self, pace: Pace) -> str:
        """Return the SHA-256 of the content.

        Raises:
            UnreadableFile: The file cannot be read.
        """
        digest = hashlib.sha256()
        with open_regular_file(self.path) as file:
            pace(0)
            while piece := file.read(PIECE_BYTES):
                digest.update(piece)
                pace(0)
        return digest.hexdigest()

    def content(self, sha256: str) -> Iterator[bytes]:
        """Yield the content in pieces.

        Raises:
            UnreadableFile: The file cannot be read.
            FileChanged: After the last piece: the content does not have the hash `sha256`.
        """
        digest = hashlib.sha256()
        with open_regular_file(self.path) as file:
            while piece := file.read(PIECE_BYTES):
                digest.update(piece)
                yield piece
        if digest.hexdigest() != sha256:
            raise FileChanged(f"{self.path.name} was written while it was copied", "run it again")


@dataclass(frozen=True, slots=True)
class StoredFile:
    """An object of a store, to copy to the path `key` below a folder."""

    key: str
    store: ObjectStore
    found: StoredObject

    @property
    def size_bytes(self) -> int:
        """The size of the object."""
        return self.found.size_bytes

    @property
    def modified_ns(self) -> int:
        """When the file was written [ns since the epoch]; in a bucket's listing, when stored."""
        return self.found.modified_ns

    def with_stamp(self) -> StoredFile:
        """Return a copy with the hash and mtime from the store, "" for an unknown hash.

        Raises:
            StoreError: The store fails, or the object does not exist any more.
        """
        return StoredFile(self.key, self.store, self.store.head(self.found.key))

    def sha256(self, pace: Pace) -> str:
        """Return the hash from the object's metadata or name, "" if there is none."""
        return self.found.sha256 or hash_in(self.found.key)

    def content(self, sha256: str) -> Iterator[bytes]:
        """Yield the content in pieces, unchecked if `sha256` is "".

        Raises:
            StoreError: The store fails, or the object changes.
            WrongContent: After the last piece: the content does not have the hash `sha256`.
        """
        digest = hashlib.sha256()
        for begin in range(0, self.size_bytes, STORED_PIECE_BYTES):
            end = min(begin + STORED_PIECE_BYTES, self.size_bytes)
            piece = self.store.get_range(self.found, begin, end)
            digest.update(piece)
            yield piece
        if sha256 not in ("", digest.hexdigest()):
            raise WrongContent(
                f"{self.store.name}/{self.found.key} does not hold what was stored",
                "something else has changed it",
            )


@dataclass(slots=True)
class OfferedRecording:
    """A recording to copy. `left_out` has a sentence for each file that cannot be copied."""

    name: str
    files: list[LocalFile | StoredFile] = field(default_factory=list)
    live: bool = False
    """Whether the recording is still being written."""

    left_out: list[str] = field(default_factory=list)

    @property
    def size_bytes(self) -> int:
        """The total size of `files`."""
        return sum(file.size_bytes for file in self.files)


def recording_of(key: str) -> str:
    """Return a file's recording: the first part of its path `key` in a copy, without `.mcap`."""
    return key.partition("/")[0].removesuffix(SUFFIX)


@contextmanager
def open_regular_file(path: Path) -> Iterator[FileIO]:
    """Open a regular file for the block; links are not followed.

    Raises:
        UnreadableFile: The path is no regular file, or opening or the block raises OSError.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    try:
        with FileIO(os.open(path, flags)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file")
            yield file
    except OSError as error:
        raise UnreadableFile(f"{path.name} cannot be read: {reason_of(error)}") from error


def stored_recordings(place: str) -> list[OfferedRecording]:
    """Return the recordings at `place`, a URL or folder of one or many recordings, or an MCAP file.

    Of several copies of a file, only the newest is returned.

    Raises:
        StoreError: The store cannot be listed, or the MCAP file does not exist.
        UsageError: `place` is not a valid URL, or obstore is not installed.
    """
    above, _, last = place.rstrip("/").rpartition("/")
    if last.endswith(SUFFIX):
        store = open_store(above)
        return [OfferedRecording(recording_of(last), [StoredFile(last, store, store.head(last))])]
    store = open_store(place)
    newest = {
        without_hashes(each.key): each
        for each in sorted(store.list(), key=lambda each: each.modified_ns)
    }
    is_one = METADATA_FILE in newest or any(
        key.startswith(f"{last}_") and key.endswith(SUFFIX) and "/" not in key for key in newest
    )
    found: dict[str, OfferedRecording] = {}
    for key, each in sorted(newest.items()):
        target = f"{last}/{key}" if is_one else key
        if _is_copied(target):
            recording = found.setdefault(
                recording_of(target), OfferedRecording(recording_of(target))
            )
            recording.files.append(StoredFile(target, store, each))
    return list(found.values())


def _is_copied(key: str) -> bool:
    parts = key.split("/")
    derived = len(parts) > 1 and parts[-1] in REPLACED
    return len(parts) <= _DEPTH and (derived or key.endswith(SUFFIX))


def is_one_recording(place: Path) -> bool:
    """Return whether `place` is one recording: a file, or a folder with a `metadata.yaml`."""
    return not place.is_dir() or (place / METADATA_FILE).is_file()


def local_recordings(place: Path, now_ns: int) -> list[OfferedRecording]:
    """Return the recordings in the folder `place`, sorted, or `place` if that is a recording.

    Links are not followed. `now_ns` is since the epoch.

    Raises:
        OSError: The folder cannot be listed.
    """
    paths = [place.absolute()] if is_one_recording(place) else sorted(place.iterdir())
    found = [_recording(path, now_ns) for path in paths]
    return [each for each in found if each.files or each.live or each.left_out]


def _recording(path: Path, now_ns: int) -> OfferedRecording:
    recording = OfferedRecording(path.name)
    try:
        if path.is_symlink():
            _link(recording, path)
        elif path.is_dir():
            _folder(recording, path, now_ns)
        elif path.name.endswith(SUFFIX):
            recording.name = path.name.removesuffix(SUFFIX)
            _add_data(recording, path, path.name, now_ns)
    except OSError as error:
        if path.name != OF_THE_SYSTEM and not path.name.startswith("."):
            recording.left_out.append(f"it cannot be listed: {reason_of(error)}")
    if not _PLAIN.fullmatch(recording.name) and (recording.files or recording.live):
        return OfferedRecording(recording.name, left_out=[f"it is left out: {_RENAME}"])
    return recording


def _link(recording: OfferedRecording, path: Path) -> None:
    """Report a link to recordings outside the link's folder."""
    target = path.resolve()
    if target.is_relative_to(path.parent.resolve()):
        return
    if path.name.endswith(SUFFIX) or (target.is_dir() and any(target.glob(f"*{SUFFIX}"))):
        recording.left_out.append("it is left out: it is a link")


def _folder(recording: OfferedRecording, folder: Path, now_ns: int) -> None:
    for path in _data_in(folder):
        _add_data(recording, path, f"{folder.name}/{path.name}", now_ns)
    is_live = recording.live
    clips = folder / CLIPS_FOLDER
    if clips.is_dir() and not clips.is_symlink():
        for path in _data_in(clips):
            _add_data(recording, path, f"{folder.name}/{CLIPS_FOLDER}/{path.name}", now_ns)
    if not is_live and (recording.files or recording.left_out):
        for path in (folder / METADATA_FILE, folder / INDEX_FILE):
            if path.is_symlink():
                _leave_out(recording, path.name, "it is a link")
            elif path.is_file():
                recording.files.append(
                    LocalFile.of(f"{folder.name}/{path.name}", path, path.stat())
                )


def _data_in(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        found = [Path(each.path) for each in entries if each.name.endswith(SUFFIX)]
    yield from sorted(found, key=natural_order)


def _add_data(recording: OfferedRecording, path: Path, key: str, now_ns: int) -> None:
    """Add a file, or mark the recording `live` or report the file."""
    if path.is_symlink():
        _leave_out(recording, path.name, "it is a link")
    elif not _PLAIN.fullmatch(path.name):
        _leave_out(recording, path.name, _RENAME)
    else:
        try:
            with open_regular_file(path) as file:
                status = os.fstat(file.fileno())
                if _is_live(path, file, status, now_ns):
                    recording.live = True
                    return
        except UnreadableFile as error:
            recording.left_out.append(str(error))
        else:
            recording.files.append(LocalFile.of(key, path, status))


def _is_live(path: Path, file: FileIO, status: os.stat_result, now_ns: int) -> bool:
    """Return whether a file is locked, or an unfinished file of another recorder."""
    try:
        if is_locked(file.fileno()):
            return True
        if is_own(path):
            return False
    except OSError:  # a file system without locks
        pass
    end = os.pread(file.fileno(), len(MAGIC), max(status.st_size - len(MAGIC), 0))
    return now_ns - status.st_mtime_ns < YOUNG_NS and end != MAGIC


def _leave_out(recording: OfferedRecording, name: str, why: str) -> None:
    recording.left_out.append(f"{printable(name)} is left out: {why}")
