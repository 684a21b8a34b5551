"""The MCAP files of a recording, to be converted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.recording.format.records import PlainMessage
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.readable_file import ReadableFile


class McapSource:
    """An MCAP file (see `ConvertibleFile`)."""

    def __init__(
        self, file: InputFile, index: FileIndex, on_progress: Callable[[int], None]
    ) -> None:
        """`on_progress` gets the offset that is reached [bytes]."""
        self.name = file.path.name
        self.profile = index.profile
        self.library = index.library
        self._index = index
        self._readable = ReadableFile(file, index, on_progress)
        self.lost = self._readable.lost

    def channels(self) -> Sequence[tuple[Channel, Schema | None]]:
        """Return the channels of the file."""
        schemas = self._index.schemas
        return [(each, schemas.get(each.schema_id)) for each in self._index.channels.values()]

    def metadata(self) -> Sequence[Metadata]:
        """Return its metadata records."""
        return self._index.metadata

    def batches(self) -> Iterator[Sequence[PlainMessage]]:
        """Yield its messages, chunk by chunk."""
        return self._readable.batches()

    def attachments(self) -> Iterator[Attachment]:
        """Yield its attachments."""
        return self._readable.attachments()
