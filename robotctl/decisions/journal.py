"""The journal of decisions: its entries, chained lines of JSON, in numbered files."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from robotctl.base.files import open_regular, sync_folder
from robotctl.base.paths import make_private, robot_state_folder
from robotctl.kernel.units import DAY_S

MAX_LINE_BYTES: Final = 32_768
"""Limit on the length of an entry; readers reject a longer line."""

MAX_TEXT: Final = 500
"""Limit on the characters of a text in an entry, such as a reason; longer texts are cut."""

_HASH_CHARACTERS: Final = 16
_RESERVED: Final = ("time_ns", "kind", "prev")


class DecisionKind(StrEnum):
    """What an entry is about; the docstring of each kind names the values of such an entry."""

    START = "start"
    """A daemon started: `by`, `version`, `software` (digest), `recording`, `observe`, `config`."""

    END = "end"
    """The daemon ended: `failure`, if there was an error. A kill or a power cut leaves no END."""

    SOFTWARE = "software"
    """Versions and digest; written if one of them differs from the last entry of this kind."""

    CONFIGURATION = "configuration"
    """All settings; written if one of them differs from the last entry of this kind."""

    MODE = "mode"
    """The mode changed: `from`, `to`, `reason`, `cause`; `latched` or `released` for a stop."""

    REQUEST = "request"
    """A request was granted: `asked`, `by`, `answer`, and `because` if the client gave a reason."""

    REFUSED = "refused"
    """A request was refused: the same values as for REQUEST."""

    PARAMETER = "parameter"
    """A setting was changed in a running daemon: `key`, `from`, `to`, `by`."""

    REMOVED = "removed"
    """Retention removed a file of a recording: `file`."""

    MORE = "more"
    """Entries were not written: `counts` by kind, in the time from `first_ns` to `last_ns`."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry; `time_ns` is since the epoch, and `values` can be encoded as JSON.

    `kind` is a `DecisionKind`, or a kind that a later version of robotctl wrote.
    """

    time_ns: int
    kind: str
    values: Mapping[str, Any]

    def line(self, prev: str) -> bytes:
        """Return the entry as a line without newline; `prev` is the hash of the line before it."""
        head = {"time_ns": self.time_ns, "kind": self.kind, "prev": prev}
        values = {key: _bounded(value) for key, value in self.values.items()}
        return json.dumps({**head, **values, **head}, separators=(",", ":")).encode()


def hash_of(line: bytes) -> str:
    """Return the hash of a line; the next line of the log has this hash as its `prev`."""
    return hashlib.sha256(line).hexdigest()[:_HASH_CHARACTERS]


def parse(line: bytes) -> tuple[Entry, str]:
    """Return a line's entry and its `prev`, the hash of the line before it.

    Raises:
        ValueError: The line is not an entry.
    """
    if len(line) > MAX_LINE_BYTES:
        raise ValueError("longer than an entry")
    try:
        found = json.loads(line)
        values = {key: value for key, value in found.items() if key not in _RESERVED}
        time_ns, kind, prev = found["time_ns"], found["kind"], found["prev"]
    except (KeyError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError("no entry") from error
    if type(time_ns) is not int or type(kind) is not str or type(prev) is not str:
        raise ValueError("no entry")
    return Entry(time_ns, kind, values), prev


def _bounded(value: object) -> object:
    if isinstance(value, str) and len(value) > MAX_TEXT:
        return f"{value[: MAX_TEXT - 1]}…"
    return value


FILE_BYTES: Final = 1_000_000
"""When a file has grown to this size, the next file is begun."""

MAX_FILE_BYTES: Final = 2 * FILE_BYTES
"""Readers read no more than this of a file; robotctl does not write larger files."""

YEAR_S: Final = 365.25 * DAY_S
"""The unit of `decisions.keep_years` in seconds."""

KEPT_FILES: Final = 2
"""The number of newest files that are never removed."""

_NAME: Final = re.compile(r"decisions-(\d{6})\.jsonl")


def log_folder(robot: str) -> Path:
    """Return the folder of the robot's decision log."""
    return robot_state_folder(robot) / "decisions"


def files_of(folder: Path) -> list[Path]:
    """Return the files of the log, the oldest first; none if there is no such folder."""
    with suppress(OSError):
        return sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name))
    return []


def number_of(path: Path) -> int:
    """Return the number of a file of the log; the first file of a robot has number 1."""
    match = _NAME.fullmatch(path.name)
    assert match is not None, path
    return int(match[1])


def content_of(path: Path) -> bytes:
    """Return the content of a file of the log, at most MAX_FILE_BYTES.

    Raises:
        OSError: It cannot be read, or is not a regular file.
    """
    with open_regular(path) as file:
        return file.read(MAX_FILE_BYTES)


def open_last(folder: Path) -> int:
    """Open the log's last file to append to, or begin one (0600), and return its descriptor.

    Raises:
        OSError: It cannot be opened, or it is not a regular file.
        UsageError: Another user could change the folder.
    """
    make_private(folder)
    files = files_of(folder)
    path = files[-1] if files else folder / _name(1)
    if files and path.lstat().st_size >= FILE_BYTES:
        path = _next(path)
    begun = not os.path.lexists(path)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o600)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):  # a FIFO that has a reader
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if begun:
        sync_folder(folder)
    return descriptor


def remove_oldest(folder: Path, keep_s: float, now_s: float) -> Path | None:
    """Remove and return the oldest file if it was last written more than `keep_s` seconds ago.

    With `keep_s` 0 nothing is removed. One call removes one file, but never one of the last
    KEPT_FILES: a clock that is years ahead must not remove a log.

    Raises:
        OSError: It cannot be removed.
    """
    files = files_of(folder)
    if len(files) <= KEPT_FILES or not keep_s or now_s - files[0].lstat().st_mtime <= keep_s:
        return None
    files[0].unlink()
    return files[0]


def _name(number: int) -> str:
    return f"decisions-{number:06}.jsonl"


def _next(path: Path) -> Path:
    return path.with_name(_name(number_of(path) + 1))


@dataclass(slots=True)
class LogContent:
    """The content of a log, and what a check of its hash chain found."""

    files: list[Path] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    """Sentences about entries that were changed, removed or added."""
    notes: list[str] = field(default_factory=list)
    """Sentences about what is no manipulation: torn lines, and files removed by robotctl."""
    heads: set[str] = field(default_factory=set)
    """The hash of each entry, and that of the line before the first entry."""

    @property
    def begins_later(self) -> bool:
        """Whether the first files of the log are missing, as after `remove_oldest`."""
        return bool(self.files) and number_of(self.files[0]) > 1


def read_log(folder: Path) -> LogContent:
    """Return the content of the log in `folder`, with entries in the order of writing.

    A line that was torn by a kill or a full disk causes a note. Entries that were removed from the
    end are not detected here: compare `heads` with the hashes in recordings (`head_of`).
    """
    log = LogContent(files_of(folder))
    prev: str | None = None
    for path in log.files:
        number = 0
        for number, line in enumerate(_lines(path, log), 1):
            try:
                entry, told = parse(line)
            except ValueError:
                log.notes.append(f"{path.name}: line {number} is torn, or no entry")
                continue
            if prev is None:
                _note_begin(log, told)
            elif told != prev:
                log.broken.append(
                    f"{path.name}: line {number} does not follow the entry before it: "
                    "something was changed, removed or added"
                )
            if prev is None:
                log.heads.add(told)
            prev = hash_of(line)
            log.heads.add(prev)
            log.entries.append(entry)
    return log


def _note_begin(log: LogContent, told: str) -> None:
    """Note in `log` if entries before its first one are missing; `told` is the first one's `prev`.

    `remove_oldest` removes only whole files, the oldest first, and keeps the last KEPT_FILES.
    """
    name = log.files[0].name
    if bool(told) != log.begins_later or (log.begins_later and len(log.files) < KEPT_FILES):
        log.broken.append(f"{name}: entries before its first one were removed, not by robotctl")
    elif told:
        log.notes.append(f"{name}: the entries before it are removed")


def head_of(folder: Path) -> str:
    """Return the hash of the last entry of the log in `folder`, "" if there is none.

    Recordings store this hash: it shows later whether entries were removed from the end.
    """
    for path in reversed(files_of(folder)):
        with suppress(OSError):
            for line in reversed(content_of(path).splitlines()):
                with suppress(ValueError):
                    parse(line)
                    return hash_of(line)
    return ""


def _lines(path: Path, log: LogContent) -> Iterator[bytes]:
    try:
        content = content_of(path)
    except OSError as error:
        log.broken.append(f"{path.name} cannot be read: {error.strerror or error}")
        return
    yield from filter(None, content.splitlines())
