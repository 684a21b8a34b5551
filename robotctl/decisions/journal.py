"""The journal of decisions: lines of JSON that are appended under a lock, in numbered files.

A line `opened` has the signed SHA-256 of the earlier lines of its file and of the previous file
(`robotctl.recording.seal`). File 0 keeps the lines about sealed files of the removed files.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import StrEnum
from fcntl import LOCK_EX, flock
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from robotctl.base.files import open_folder, open_regular, sync_folder
from robotctl.base.paths import make_private, robot_state_folder
from robotctl.kernel.constants import DAY_S

MAX_LINE_BYTES: Final = 32_768

MAX_TEXT: Final = 500
"""Limit on the characters of a text in an entry; longer texts are cut."""

FILE_BYTES: Final = 1_000_000
"""The size of a file at which the next file is begun."""

MAX_FILE_BYTES: Final = 2 * FILE_BYTES
"""Limit on the bytes that are read of a file."""

MAX_KEPT_BYTES: Final = 256 << 20
"""Limit on the bytes that are read of file 0."""

YEAR_S: Final = 365.25 * DAY_S
"""The unit of `decisions.keep_years` in seconds."""

KEPT_FILES: Final = 2
"""The number of newest files that are never removed, whatever the clock says."""

FOLDER: Final = "decisions"

_NAME: Final = re.compile(r"decisions-(?!000000)\d{6}\.jsonl")
_OLD_HASH_CHARACTERS: Final = 16
_RESERVED: Final = ("time_ns", "kind", "prev")  # `prev`: a hash that early versions wrote


class DecisionKind(StrEnum):
    """The kind of an entry; the docstring of each kind lists the keys of the entry's `values`."""

    START = "start"
    """A daemon started: `by`, `version`, `software` (digest), `recording`, `observe`, `config`."""

    END = "end"
    """The daemon ended: `failure`, if there was an error. A kill or a power cut leaves no END."""

    SOFTWARE = "software"
    """Versions and digest, written after a change."""

    CONFIGURATION = "configuration"
    """All settings, written after a change."""

    MODE = "mode"
    """The mode changed: `from`, `to`, `reason`, `cause`; `latched` or `released` for a stop."""

    REQUEST = "request"
    """A granted request changed something: `asked`, `by`, `answer`, and `because` (the reason)."""

    REFUSED = "refused"
    """A request was refused: the same values as for REQUEST."""

    PARAMETER = "parameter"
    """A setting was changed in a running daemon: `key`, `from`, `to`, `by`."""

    REMOVED = "removed"
    """Retention removed a file of a recording: `file`."""

    MORE = "more"
    """Entries were not written: `counts` by kind, in the time from `first_ns` to `last_ns`."""

    OPENED = "opened"
    """A sealed file was opened: `opened`, `journal` (`digests` before this line), `signature`."""

    CLOSED = "closed"
    """A sealed file was closed: `closed`, its last head."""

    ROTATED = "rotated"
    """A new chain of keys was begun: `rotated`."""


ABOUT_SEALS: Final = (DecisionKind.OPENED, DecisionKind.CLOSED, DecisionKind.ROTATED)
"""The kinds of entries without retention and budget."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry; `time_ns` is since the epoch, and `kind` may be one of a later version."""

    time_ns: int
    kind: str
    values: Mapping[str, Any]

    def line(self) -> bytes:
        """Return the entry as a line of JSON; long texts in it are cut."""
        head = {"time_ns": self.time_ns, "kind": self.kind}
        values = {key: _bounded(value) for key, value in self.values.items()}
        return json.dumps({**head, **values, **head}, separators=(",", ":")).encode() + b"\n"


def _bounded(value: object) -> object:
    is_long = isinstance(value, str) and len(value) > MAX_TEXT
    return f"{str(value)[: MAX_TEXT - 1]}…" if is_long else value


def parse(line: bytes) -> Entry:
    """Return the entry that `line` holds as JSON.

    Raises:
        ValueError: The line is not an entry.
    """
    if len(line) > MAX_LINE_BYTES:
        raise ValueError("longer than an entry")
    try:
        found = json.loads(line)
        values = {key: value for key, value in found.items() if key not in _RESERVED}
        time_ns, kind = found["time_ns"], found["kind"]
    except (KeyError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError("no entry") from error
    if type(time_ns) is not int or type(kind) is not str:
        raise ValueError("no entry")
    return Entry(time_ns, kind, values)


def log_folder(robot: str) -> Path:
    """Return the folder of the decision journal of `robot`."""
    return robot_state_folder(robot) / FOLDER


def files_of(folder: Path) -> list[Path]:
    """Return the journal's files without file 0, the oldest first; [] if `folder` is unreadable."""
    with suppress(OSError):
        return sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name))
    return []


def kept_file(folder: Path) -> Path:
    """Return the path of file 0, which keeps lines about sealed files."""
    return folder / _name(0)


def entries_in(path: Path, *kinds: str) -> Iterator[Entry]:
    """Yield the entries of a file that are of `kinds`, or all entries if no kind is given.

    Raises:
        OSError: The file cannot be read, or is not a regular file.
    """
    marks = [f'"kind":"{kind}"'.encode() for kind in kinds]
    for line in _content_of(path).splitlines():
        if not kinds or any(mark in line for mark in marks):
            with suppress(ValueError):
                yield parse(line)


def _content_of(path: Path) -> bytes:
    with open_regular(path) as file:
        return file.read(MAX_FILE_BYTES if _NAME.fullmatch(path.name) else MAX_KEPT_BYTES)


def _name(number: int) -> str:
    return f"decisions-{number:06}.jsonl"


def _number_of(path: Path) -> int:
    return int(path.name[-12:-6])


# Writing: all of it under the lock


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create the folder if it is missing, and lock it against other writers during the block.

    Raises:
        OSError: The folder cannot be opened.
        UsageError: Another user could change the folder, or the folder cannot be created.
    """
    make_private(folder)
    with open_folder(folder) as descriptor:
        with suppress(OSError):  # some network file systems have no locks
            flock(descriptor, LOCK_EX)
        yield


def last_file(folder: Path) -> Path:
    """Return the newest file, or a new one if it is full; complete a torn last line.

    Raises:
        OSError: The file cannot be written.
    """
    files = files_of(folder)
    number = _number_of(files[-1]) if files else 1
    if files and files[-1].lstat().st_size >= FILE_BYTES:
        number += 1
    append(folder / _name(number), [])
    return folder / _name(number)


def append(path: Path, entries: Iterable[Entry]) -> None:
    """Append `entries` to a file (mode 0600) in one write, and wait until they are on the disk.

    They begin on a new line, even after a torn one.

    Raises:
        OSError: The disk is full or fails, or `path` is not a regular file of this user.
    """
    begins = not os.path.lexists(path)
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o600)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
            raise OSError(errno.EINVAL, "it is not a regular file of this user", str(path))
        torn = found.st_size and os.pread(descriptor, 1, found.st_size - 1) != b"\n"
        data = (b"\n" if torn else b"") + b"".join(entry.line() for entry in entries)
        if os.write(descriptor, data) < len(data):
            os.ftruncate(descriptor, found.st_size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    if begins:
        sync_folder(path.parent)


def remove_oldest(folder: Path, keep_s: float, now_s: float) -> None:
    """Remove the oldest file if it was last written more than `keep_s` seconds ago.

    Nothing is removed if `keep_s` is 0, and none of the last KEPT_FILES. Lines about sealed files
    are kept in file 0.

    Raises:
        OSError: The file cannot be removed, or file 0 cannot be written.
    """
    files = files_of(folder)
    if len(files) > KEPT_FILES and keep_s and now_s - files[0].lstat().st_mtime > keep_s:
        if kept := [*entries_in(files[0], *ABOUT_SEALS)]:
            append(kept_file(folder), kept)
        files[0].unlink()


# Reading


def digests(folder: Path) -> list[str]:
    """Return the SHA-256 of the whole lines of each of the last two files, the older file first.

    Raises:
        OSError: A file cannot be read.
    """
    found = []
    for path in files_of(folder)[-2:]:
        with open_regular(path) as file:
            os.fsync(file.fileno())  # in a power cut, no digest outlives its lines
            found.append(_digest(file.read(MAX_FILE_BYTES)))
    return found


def _digest(content: bytes) -> str:
    return sha256(content[: content.rfind(b"\n") + 1]).hexdigest()


def head_of(folder: Path) -> str:
    """Return the digest of the journal's newest file, "" if there is none or it cannot be read."""
    with suppress(OSError, IndexError):
        return digests(folder)[-1]
    return ""


@dataclass(frozen=True, slots=True)
class OpenedLine:
    """An OPENED entry. Its value `journal` must equal `before`, the digests of the lines before."""

    entry: Entry
    place: str
    before: Sequence[str]


@dataclass(slots=True)
class LogContent:
    """The entries of a journal, and the faults of its files in sentences."""

    files: list[Path] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    """The entries in the order of writing, without those about sealed files."""

    opened: list[OpenedLine] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    """Sentences about files that are missing or unreadable."""
    notes: list[str] = field(default_factory=list)
    """Sentences about harmless findings: torn lines, and files that robotctl removed."""
    heads: set[str] = field(default_factory=set)
    """Digests that recordings may store, of a file up to a line (early versions: of a line)."""

    @property
    def begins_later(self) -> bool:
        """Whether the oldest files of the journal are gone, as after `remove_oldest`."""
        return bool(self.files) and _number_of(self.files[0]) > 1


def read_log(folder: Path) -> LogContent:
    """Return the entries of the journal in `folder`, and what is wrong with its files.

    `broken` and `notes` report missing or unreadable files and torn lines. Other changes show in
    digests: each of `opened` must equal its `before`, those in recordings must be in `heads`.
    """
    log = LogContent(files_of(folder))
    numbers = [_number_of(path) for path in log.files]
    if log.begins_later:  # `remove_oldest` keeps the last KEPT_FILES
        name, few = log.files[0].name, len(numbers) < KEPT_FILES
        log.broken += [f"{name}: the entries before it were removed, not by robotctl"] * few
        log.notes += [f"{name}: the entries before it are removed"] * (not few)
    if numbers and numbers[-1] - numbers[0] >= len(numbers):
        log.broken.append("a file between others was removed, not by robotctl")
    before = {0: ""}
    for number, path in zip(numbers, log.files, strict=True):
        try:
            content = _content_of(path)
        except OSError as error:
            log.broken.append(f"{path.name} cannot be read: {error.strerror or error}")
            continue
        _read_lines(path.name, content, [before.get(number - 1, "")] * (number > 1), log)
        before[number] = _digest(content)
    return log


def _read_lines(name: str, content: bytes, before: Sequence[str], log: LogContent) -> None:
    running = sha256()
    log.heads.add(running.hexdigest())
    for number, line in enumerate(content.splitlines(keepends=True), 1):
        digest = running.hexdigest()
        running.update(line)
        text = line.rstrip(b"\r\n")
        log.heads |= {running.hexdigest(), sha256(text).hexdigest()[:_OLD_HASH_CHARACTERS]}
        place = f"{name}: line {number}"
        try:
            entry = parse(text)
        except ValueError:
            log.notes += [f"{place} is torn, or no entry"] * bool(text)
            continue
        if entry.kind == DecisionKind.OPENED:
            log.opened.append(OpenedLine(entry, place, [*before, digest]))
        elif entry.kind not in ABOUT_SEALS:
            log.entries.append(entry)
