"""Read a decision log, and say where it was not only appended to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from robotctl.decision_log.entries import Entry, hash_of, parse
from robotctl.decision_log.folder import KEPT_FILES, content_of, files_of, number_of


@dataclass(slots=True)
class LogContent:
    """What a log holds. `broken` says where entries were changed or removed, `notes` the rest."""

    files: list[Path] = field(default_factory=list)
    entries: list[Entry] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    heads: set[str] = field(default_factory=set)
    """The hash of each entry, and of the one before the first."""

    @property
    def begins_later(self) -> bool:
        """Whether whole files before those that are there were removed, as the log does itself."""
        return bool(self.files) and number_of(self.files[0]) > 1


def read_log(folder: Path) -> LogContent:
    """Return all entries of the log in `folder`, in the order in which they were written.

    A line that a kill or a full disk tore is told in a note. Entries that were removed from the end
    leave no trace here: compare the `heads` with those in recordings.
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
    """Say whether entries were removed before the first one, which holds the hash `told`.

    The log removes whole files, the oldest first, and never the last ones.
    """
    name = log.files[0].name
    if bool(told) != log.begins_later or (log.begins_later and len(log.files) < KEPT_FILES):
        log.broken.append(f"{name}: entries before its first one were removed, not by robotctl")
    elif told:
        log.notes.append(f"{name}: the entries before it are removed")


def head_of(folder: Path) -> str:
    """Return the hash of the last entry of the log in `folder`, "" if there is none.

    A recording holds it: so entries that are removed from the end later leave a trace.
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
