"""Converts a recording: each message stays as it is, byte for byte; its files change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from robotctl.recording.convert.channel_table import ChannelTable
from robotctl.recording.convert.convertible import ConvertibleFile
from robotctl.recording.convert.output import OutputFile
from robotctl.recording.format.names import (
    CONVERSION_RECORD,
    FOXGLOVE_RECORD,
    INFO_RECORD,
    LEDGER_RECORD,
    SOFTWARE_RECORD,
    Compression,
)
from robotctl.recording.format.records import PlainMessage
from robotctl.recording.format.rosbag2 import METADATA_RECORD, BagFile, write_metadata

_OF_EACH_FILE: Final = (INFO_RECORD, SOFTWARE_RECORD, FOXGLOVE_RECORD)
"""What made the recording; each file begins with it."""

_REWRITTEN: Final = (METADATA_RECORD, LEDGER_RECORD, CONVERSION_RECORD)


@dataclass(frozen=True, slots=True)
class Form:
    """The form of the result.

    With `split_bytes` a new file begins when one has that size, with `one_file` there is only one;
    with neither, each file of the source becomes one.
    """

    compression: Compression = Compression.ZSTD
    split_bytes: int | None = None
    one_file: bool = False


@dataclass(slots=True)
class Converted:
    """What was converted; `lost` says in sentences what could not be read."""

    files: list[BagFile] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    attachment_count: int = 0
    is_live: bool = False
    """Whether the source was still being recorded: later messages are missing."""

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(file.message_count for file in self.files)


class Converter:
    """Writes the files of a new recording, one source file after the other."""

    def __init__(self, name_of: Callable[[int], Path], form: Form) -> None:
        """`name_of` gives the path of each new file, from 0 on."""
        self._name_of = name_of
        self._form = form
        self._table = ChannelTable()
        self._output: OutputFile | None = None
        self._ledger: list[Metadata] = []
        self._begun = 0
        self._sources: list[str] = []
        self.done = Converted()

    def run(self, sources: Iterable[ConvertibleFile]) -> Converted:
        """Convert the files in their order.

        Raises:
            OSError: The disk is full or fails.
        """
        try:
            for source in sources:
                self._convert(source)
            self._finish()
        finally:
            if self._output is not None:
                with suppress(OSError):
                    self._output.close()
        return self.done

    def write_list(self, folder: Path) -> None:
        """Write `metadata.yaml` into the folder of the files.

        Raises:
            OSError: It cannot be written.
        """
        write_metadata(folder, self._table.topics, self.done.files)

    def _convert(self, source: ConvertibleFile) -> None:
        ids = {
            channel.id: self._table.add(channel, schema) for channel, schema in source.channels()
        }
        output = self._file_for(source)
        self._ledger = []
        for messages in source.batches():
            if self._is_full(output):
                self._finish()
                output = self._begin(source)
            output.write(_renumbered(messages, ids))
        for attachment in source.attachments():
            output.add_attachment(attachment)
            self.done.attachment_count += 1
        kept = [each for each in source.metadata() if each.name not in _REWRITTEN]
        output.add_metadata([each for each in kept if each.name not in _OF_EACH_FILE])
        self._ledger = [each for each in source.metadata() if each.name == LEDGER_RECORD][-1:]
        prefix = f"{source.name}: "
        self.done.lost += (prefix + sentence for sentence in source.lost)

    def _file_for(self, source: ConvertibleFile) -> OutputFile:
        """Return the file into which a source file goes first."""
        output = self._output
        if output is None:
            return self._begin(source)
        if self._form.one_file or (self._form.split_bytes and not self._is_full(output)):
            self._sources.append(source.name)
            return output
        self._finish()
        return self._begin(source)

    def _begin(self, source: ConvertibleFile) -> OutputFile:
        path = self._name_of(self._begun)
        self._begun += 1
        self._output = OutputFile(
            path, self._table, self._form.compression, source.profile, source.library
        )
        self._sources = [source.name]
        latest = {each.name: each for each in source.metadata() if each.name in _OF_EACH_FILE}
        self._output.add_metadata(list(latest.values()))
        return self._output

    def _finish(self) -> None:
        if self._output is None:
            return
        about = {"of": ", ".join(self._sources), "lost": "\n".join(self.done.lost)}
        self._output.add_metadata([Metadata(name=CONVERSION_RECORD, metadata=about)])
        self.done.files.append(self._output.finish(self._ledger))
        self._output, self._ledger = None, []

    def _is_full(self, output: OutputFile) -> bool:
        limit = self._form.split_bytes
        return limit is not None and output.has_messages and output.size >= limit


def _renumbered(messages: Sequence[PlainMessage], ids: dict[int, int]) -> list[PlainMessage]:
    return [(ids[channel], *rest) for channel, *rest in messages]  # type: ignore[misc]
