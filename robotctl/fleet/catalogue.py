"""The catalogue of a folder: the indexes of all its recordings in one file, without the samples.

Opening 10,000 small files takes seconds; the catalogue is read at once, and holds what it was made
from: only what has changed since then is read again.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.catalogue_file import write_catalogue
from robotctl.fleet.database import file_of
from robotctl.fleet.index_file import (
    closed_files,
    files_of,
    index_path,
    index_path_text,
    stamp_of,
)
from robotctl.fleet.indexing import Failures, index_recordings
from robotctl.fleet.stamps import Stamps, stamps_in, stamps_of_each
from robotctl.printable import printable
from robotctl.recording.format.derived_files import INDEX_FILE
from robotctl.regular_file import open_regular

CATALOGUE_NAME: Final = INDEX_FILE

GOING_ON: Final = "it is being recorded"
NOT_TEXT: Final = "its name is no UTF-8"
NOT_ALLOWED: Final = "this user may not read it"


@dataclass(frozen=True, slots=True)
class Catalogue:
    """A catalogue that is up to date: its file, and the path of each recording's index.

    `left_out` has a sentence for each recording that is missing, or missing in part because it
    goes on. `failures` are those that cannot be indexed, each with the reason.
    """

    path: Path
    indexes: tuple[str, ...]
    left_out: tuple[str, ...]
    failures: Failures


@contextmanager
def catalogue_of(
    folder: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[Catalogue]:
    """Index what has changed in a folder, and yield its catalogue.

    Where the folder cannot be written, or its disk is full, the catalogue is a file that exists for
    the block only.

    Raises:
        OSError: The folder cannot be listed.
        Refused: The catalogue cannot be written anywhere, or the folder has an impossible name.
        UsageError: duckdb is not installed.
    """
    path = folder / CATALOGUE_NAME
    if not _is_text(str(path)):
        raise Refused(f"{printable(folder)}: {NOT_TEXT}", "give the folder another name")
    with ExitStack() as stack:
        before = _opened(path, stack)
        known = stamps_in(before) if before else {}
        stamps, left_out = _stamps(folder, known)
        changed = [folder / name for name, stamp in stamps.items() if known.get(name) != stamp]
        indexed = stamps_of_each(list(map(index_path, changed)))
        old = [
            each
            for each, found in zip(changed, indexed, strict=True)
            if found != {each.name: stamps[each.name]}
        ]
        failures = index_recordings(old, on_progress) if old else {}
        for each in changed:
            if each not in failures and not index_path(each).exists():
                failures[each] = "it was removed meanwhile"
        left_out += [_left_out(each.name, said) for each, said in failures.items()]
        fresh = [index_path(each) for each in changed if each not in failures]
        failed = {each.name for each in failures}
        kept = [name for name, stamp in stamps.items() if known.get(name) == stamp]
        indexes = tuple(
            index_path_text(f"{folder}/{name}") for name in stamps if name not in failed
        )
        if fresh or len(kept) < len(known) or not before:
            elsewhere = Path(stack.enter_context(tempfile.TemporaryDirectory()), CATALOGUE_NAME)
            path = write_catalogue((path, elsewhere), before if kept else None, kept, fresh)
        yield Catalogue(path, indexes, tuple(left_out), failures)


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def _opened(path: Path, stack: ExitStack) -> str | None:
    """Return the path of an open catalogue, which holds if another process replaces it."""
    try:
        if path.is_symlink():
            return None
        return file_of(stack.enter_context(open_regular(path)))
    except OSError:
        return None


def _stamps(folder: Path, known: Stamps) -> tuple[Stamps, list[str]]:
    """Return the stamp of each recording directly below a folder, and what is left out.

    Only a recording whose stamp is not the one `known` can go on: then it is that of its closed
    files. Links are not followed.
    """
    stamps: Stamps = {}
    left_out = []
    with os.scandir(folder) as entries:
        found = sorted((each.name, each.path) for each in entries if _may_be_recording(each))
    for name, path in found:
        if not _is_text(name):
            left_out.append(_left_out(name, NOT_TEXT))
            continue
        try:
            files = files_of(path)
            if not files:
                continue
            stamps[name] = stamp_of(files)
            if known.get(name) == stamps[name]:
                continue
            closed = closed_files(files)
        except PermissionError:
            stamps.pop(name, None)
            left_out.append(_left_out(name, NOT_ALLOWED))
        except OSError:  # it was removed meanwhile
            stamps.pop(name, None)
        else:
            if not closed:
                del stamps[name]
                left_out.append(_left_out(name, GOING_ON))
            elif len(closed) < len(files):
                stamps[name] = stamp_of(closed)
                left_out.append(f"the last file of {_left_out(name, GOING_ON)}")
    return stamps, left_out


def _may_be_recording(entry: os.DirEntry[str]) -> bool:
    if entry.name.endswith(".mcap") and entry.is_file(follow_symlinks=False):
        return True
    return not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)


def _left_out(name: str, reason: str) -> str:
    return f"{printable(name)} is left out: {reason}"
