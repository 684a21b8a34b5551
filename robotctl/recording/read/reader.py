"""Opening any MCAP recording: one file, or a folder as rosbag2 lays it out.

A file without a valid summary is scanned. What cannot be read is never passed over in silence:
it stands in `RecordingInfo.missing`, or ends the iteration over messages with UnreadableFile.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Self

from mcap.records import Channel, Metadata, Schema

from robotctl.errors import UnreadableFile
from robotctl.recording.format.metadata_names import CLIP_RECORD, LEDGER_RECORD
from robotctl.recording.format.rosbag2 import metadata_text
from robotctl.recording.format.type_names import type_name_of
from robotctl.recording.read.count_check import find_shortfalls
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.files import absent_files, recording_files
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.info import RecordingInfo, describe, metadata_in
from robotctl.recording.read.lookback import last_before
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.merge import in_order_written, merge
from robotctl.recording.read.messages import ALWAYS, Message, OpenFile, Window
from robotctl.recording.read.read_limits import ReadLimits


def read_info(path: Path) -> RecordingInfo:
    """What `path` holds, a file or a folder. Raises UnreadableFile if nothing can be read."""
    with Recording(path) as recording:
        return recording.info()


def read_messages(
    path: Path,
    topics: Collection[str] | None = None,
    on_missing: Callable[[str], None] | None = None,
) -> Iterator[Message]:
    """The messages in the order of their log time; of `topics` only, if given.

    What cannot be read is told to `on_missing`, a sentence each; without it the iteration ends
    with UnreadableFile after the last message that can be read.
    """
    missing: list[str] = []
    tell = on_missing or (lambda sentence: note_missing(missing, sentence))
    with Recording(path) as recording:
        for sentence in recording.missing:
            tell(sentence)
        yield from recording.messages(topics, tell)
        if missing:
            raise UnreadableFile(f"{path} is incomplete: {'; '.join(missing)}")


class Recording:
    """An open recording. Close it, or use it in a `with` block."""

    def __init__(
        self, path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Open `path`; `on_progress` gets bytes done and in total where files are scanned.

        Raises UnreadableFile if nothing can be read.
        """
        self.path = path
        self._files: list[OpenFile] = []
        self.missing: list[str] = []
        text = metadata_text(path)
        paths = recording_files(path)
        all_files = False
        if paths != [path]:
            absent = absent_files(text, paths)
            all_files = not absent
            for sentence in absent:
                note_missing(self.missing, sentence)
        try:
            for each in paths:
                self._open(each, only=paths == [path], on_progress=on_progress)
        except BaseException:
            self.close()
            raise
        if not self._files:
            raise UnreadableFile(f"{path} cannot be read: {'; '.join(self.missing)}")
        for sentence in find_shortfalls(text, self._files, all_files=all_files):
            note_missing(self.missing, sentence)

    def close(self) -> None:
        """Close the files."""
        for each in self._files:
            each.file.close()

    def __enter__(self) -> Self:
        """The recording itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    @property
    def limits(self) -> ReadLimits:
        """How much work its size allows."""
        return ReadLimits.of(sum(each.file.stored_bytes for each in self._files))

    def info(self) -> RecordingInfo:
        """What it holds."""
        return describe(self.path, self._files, self.missing)

    @property
    def is_live(self) -> bool:
        """Whether a process still writes its last file."""
        return self._files[-1].file.is_changing()

    @property
    def is_cut_off(self) -> bool:
        """Whether the process that recorded it ended without closing it, or stopped recording."""
        return not self.is_live and not self._files[-1].index.has_metadata(
            LEDGER_RECORD, CLIP_RECORD
        )

    def metadata(self) -> list[Metadata]:
        """Every metadata record, in the order of the files."""
        return metadata_in(self._files)

    def channels(self) -> dict[tuple[str, str], tuple[Channel, Schema | None]]:
        """Of each topic and type name what the first file says about it."""
        channels: dict[tuple[str, str], tuple[Channel, Schema | None]] = {}
        for each in self._files:
            for channel in each.index.channels.values():
                schema = each.index.schemas.get(channel.schema_id)
                key = channel.topic, type_name_of(channel, schema)
                channels.setdefault(key, (channel, schema))
        return channels

    def messages(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        window: Window = ALWAYS,
    ) -> Iterator[Message]:
        """The messages in the order of their log time; `on_missing` gets what is found lost.

        Only those with a log time in `window` (ns, both ends included): nothing else is read.
        """
        return merge(self._files, topics, on_missing, window)

    def last_before(
        self, moment_ns: int, wanted: Mapping[str, int], on_missing: Callable[[str], None]
    ) -> list[Message]:
        """Of each topic in `wanted` so many of the last messages before a moment, in order."""
        return last_before(self._files, wanted, moment_ns, on_missing)

    def in_order_written(
        self,
        topics: Collection[str] | None,
        on_missing: Callable[[str], None],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> Iterator[Message]:
        """As `messages`, in the order of the files: log times step back where the clock was set.

        `on_progress` gets bytes done and in total.
        """
        return in_order_written(self._files, topics, on_missing, on_progress)

    def _open(self, path: Path, *, only: bool, on_progress: Callable[[int, int], None]) -> None:
        try:
            file = InputFile(path, on_progress)
        except OSError as error:
            self._give_up(path, error.strerror or repr(error), only=only)
            return
        except Damaged as damage:
            self._give_up(path, str(damage), only=only)
            return
        try:
            index = index_of(file, lambda done: on_progress(done, file.size))
        except Damaged as damage:
            file.close()
            self._give_up(path, str(damage), only=only)
            return
        self._files.append(OpenFile(path, file, index))
        prefix = "" if only else f"{path.name}: "
        for sentence in index.missing:
            note_missing(self.missing, prefix + sentence)

    def _give_up(self, path: Path, reason: str, *, only: bool) -> None:
        note_missing(self.missing, reason if only else f"{path.name}: {reason}")
