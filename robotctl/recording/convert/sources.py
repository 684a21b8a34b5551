"""Opens the files of a recording for conversion, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory

from robotctl.recording.convert.convertible import ConvertibleFile
from robotctl.recording.convert.mcap_source import McapSource
from robotctl.recording.convert.sqlite_source import SqliteSource
from robotctl.recording.format.names import natural_order
from robotctl.recording.format.rosbag2 import metadata_text, total_count_in
from robotctl.recording.read.count_check import find_shortfalls
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.files import (
    SQLITE_SUFFIX,
    absent_files,
    recording_files,
)
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.messages import OpenFile
from robotctl.recording.read.zstd_file import SUFFIX, unpack_zstd_file
from robotctl.regular_file import open_regular

Progress = Callable[[int, int], None]
"""Gets bytes done, and in total."""


class Sources:
    """The files of the recording `path`, in MCAP or sqlite3.

    `lost` and `is_live` are complete after they were read; `lost` has a sentence about each file
    that is not there or cannot be opened.
    """

    def __init__(self, path: Path, on_progress: Progress) -> None:
        """Find the files.

        Raises:
            UnreadableFile: There are none, or `path` is not a recording.
        """
        text = metadata_text(path)
        self._paths = _sqlite_files(path) or recording_files(path)
        is_whole = self._paths != [path]
        self.lost = absent_files(text, self._paths) if is_whole else []
        self.told_messages = total_count_in(text) if is_whole else 0
        """Messages that `metadata.yaml` counts, 0 if it says nothing."""

        self.is_live = False
        """Whether a file was still being recorded when it was read."""

        self._text = text
        self._on_progress = on_progress
        self._total = sum(map(_size, self._paths))

    def __iter__(self) -> Iterator[ConvertibleFile]:
        """Yield each file; it is open until the next one is asked for."""
        before = 0
        for path in self._paths:
            size = _size(path)
            open_file = _open_sqlite if _is_sqlite(path) else self._open_mcap
            try:
                yield from open_file(path, _Share(self._on_progress, before, size, self._total))
            except Damaged as damage:
                self.lost.append(f"{path.name}: {damage}")
            except OSError as error:
                self.lost.append(f"{path.name}: {error.strerror or error}")
            before += size

    def _open_mcap(self, path: Path, share: _Share) -> Iterator[ConvertibleFile]:
        with InputFile(path) as file:
            self.is_live |= file.is_changing()
            size = max(file.size, 1)
            # Half is for the index, which is quick unless the file must be scanned.
            index = index_of(file, lambda done: share.tell(done / size / 2))
            for sentence in find_shortfalls(
                self._text, [OpenFile(path, file, index)], all_files=False
            ):
                index.miss(sentence)
            yield McapSource(file, index, lambda done: share.tell(done / size))


@dataclass(frozen=True, slots=True)
class _Share:
    """The part of a file in the progress, in bytes."""

    on_progress: Progress
    before: int
    size: int
    total: int

    def tell(self, part: float) -> None:
        """Take how much of the file is done, from 0 to 1."""
        self.on_progress(self.before + round(min(part, 1.0) * self.size), self.total)


def _open_sqlite(path: Path, share: _Share) -> Iterator[ConvertibleFile]:
    with open_regular(path) as file, TemporaryDirectory() as folder:
        content = path
        if path.name.endswith(SUFFIX):
            content = Path(folder) / path.stem
            unpacked = unpack_zstd_file(file.fileno(), lambda done, total: None)
            with open(unpacked, "rb") as plain, content.open("wb") as named:
                plain.seek(0)
                copyfileobj(plain, named)  # sqlite3 opens a file by its name
        with closing(SqliteSource(path, content, share.tell)) as source:
            yield source


def _sqlite_files(path: Path) -> list[Path]:
    """Return the sqlite3 files of a bag, in their order; none if it is in MCAP."""
    try:
        if not path.is_dir():
            return [path] if _is_sqlite(path) else []
        files = [each for each in path.iterdir() if _is_sqlite(each)]
        is_mcap = any(path.glob("*.mcap*"))
    except OSError:
        return []
    names = {each.name for each in files}
    unpacked = [each for each in files if each.name.removesuffix(SUFFIX) not in names - {each.name}]
    return [] if is_mcap else sorted(unpacked, key=natural_order)


def _is_sqlite(path: Path) -> bool:
    return path.name.endswith((SQLITE_SUFFIX, SQLITE_SUFFIX + SUFFIX))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
