"""The hashes of files that were hashed before, in a file beside the recordings."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple
from fcntl import LOCK_EX, LOCK_NB, flock
from pathlib import Path
from typing import Final

from robotctl.collect.local_files import FileStamp, Pace, hash_of_file, open_collected, stamp_of
from robotctl.errors import AlreadyRunning, UnreadableFile
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.disk.access import make_folder, open_private
from robotctl.recording.disk.replaced_file import replaced_file
from robotctl.regular_file import open_regular

FOLDER: Final = ".sync"
"""In the folder of recordings; its name begins with a dot, so no command takes it for one."""

_FILE: Final = "hashes.jsonl"
_MAX_BYTES: Final = 256 << 20
_APPEND: Final = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
_RESTLESS_NS: Final = 2 * NS_PER_S
"""A file that was written this recently could change again without a new time stamp."""


class FileChanged(UnreadableFile):
    """A file that was written while it was read."""


class HashLedger:
    """The SHA-256 of files by their stamp; each new one is appended at once.

    A file system that is full or read-only only costs time: files are then hashed again.
    """

    def __init__(self, path: Path, recordings: Path, now_ns: Callable[[], int]) -> None:
        self._path = path
        self._recordings = recordings
        self.now_ns = now_ns
        self._known = dict(_entries(path))
        self._asked: set[str] = set()
        self.hashed_bytes = 0
        """Bytes that were read because no hash of them was known."""

    def hash_of(self, path: Path, pace: Pace) -> tuple[FileStamp, str]:
        """Return stamp and SHA-256 of a file; `pace(0)` may delay each piece that is read.

        Raises:
            UnreadableFile: It cannot be read.
            FileChanged: It was written meanwhile.
        """
        name = str(path.relative_to(self._recordings))
        with open_collected(path) as file:
            stamp = stamp_of(file)
            known, sha256 = self._known.get(name, (None, ""))
            if known != stamp:
                sha256 = hash_of_file(file, pace)
                if stamp_of(file) != stamp:
                    raise FileChanged(f"{path.name} was written while it was read", "run it again")
                self.hashed_bytes += stamp.size
                if self.now_ns() - stamp.modified_ns > _RESTLESS_NS:
                    self._append(name, stamp, sha256)
        self._asked.add(name)
        return stamp, sha256

    def forget(self, path: Path) -> None:
        """Let a file be hashed again by the next run: its content changed, but not its stamp."""
        self._asked.discard(str(path.relative_to(self._recordings)))

    def forget_the_rest(self) -> None:
        """Drop the files that were not asked for: they are gone."""
        if self._known.keys() <= self._asked:
            return
        kept = {name: self._known[name] for name in self._known if name in self._asked}
        with suppress(OSError), replaced_file(self._path) as file:
            for name, (stamp, sha256) in kept.items():
                file.write(_line(name, stamp, sha256))
        self._known = kept

    def _append(self, name: str, stamp: FileStamp, sha256: str) -> None:
        self._known[name] = (stamp, sha256)
        with suppress(OSError):
            descriptor = open_private(self._path, _APPEND)
            try:
                os.write(descriptor, _line(name, stamp, sha256))
            finally:
                os.close(descriptor)


@contextmanager
def hash_ledger(recordings: Path, now_ns: Callable[[], int]) -> Iterator[HashLedger]:
    """Yield the ledger of a folder of recordings; no other process has it meanwhile.

    Raises:
        AlreadyRunning: Another process copies the recordings of this folder.
    """
    folder = recordings / FOLDER
    descriptor = -1
    with suppress(OSError):  # it is there, or the disk is full
        make_folder(folder, shared=False)
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if descriptor >= 0:
            _lock(descriptor, recordings)
        yield HashLedger(folder / _FILE, recordings, now_ns)
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def _lock(descriptor: int, recordings: Path) -> None:
    try:
        flock(descriptor, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        raise AlreadyRunning(
            f"another process copies the recordings of {recordings}", "wait until it has ended"
        ) from None
    except OSError:
        pass  # some network file systems have no locks


def _entries(path: Path) -> Iterator[tuple[str, tuple[FileStamp, str]]]:
    """Yield what the ledger holds; a line that a kill or a full disk tore is left out."""
    try:
        with open_regular(path) as file:
            lines = file.read(_MAX_BYTES).splitlines()
    except OSError:
        return
    for line in lines:
        with suppress(ValueError, TypeError, RecursionError):
            name, *stamp, sha256 = json.loads(line)
            yield str(name), (FileStamp(*map(int, stamp)), str(sha256))


def _line(name: str, stamp: FileStamp, sha256: str) -> bytes:
    return json.dumps([name, *astuple(stamp), sha256]).encode() + b"\n"
