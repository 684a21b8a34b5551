"""The readable content of one MCAP file, to be copied."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from mcap.records import Attachment

from robotctl.recording.format.records import PlainMessage
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.file_index import (
    FileIndex,
    Place,
    note_missing,
    read_attachment,
    read_record_head,
)
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.messages import ALWAYS, OpenFile, PlaceReader, names_of

_BATCH_BYTES: Final = 8 << 20
"""About this many bytes of messages become one chunk of the copy; original chunks may be larger."""


class ReadableFile:
    """The messages and attachments of a file in file order; `lost` has a sentence for each loss."""

    def __init__(
        self,
        file: InputFile,
        index: FileIndex,
        on_progress: Callable[[int], None] = lambda done: None,
    ) -> None:
        """`on_progress` gets the offset [bytes] that was reached."""
        self._file = file
        self._index = index
        self._open_file = OpenFile(file.path, file, index)
        self._names = names_of(index)
        self._on_progress = on_progress
        self.lost = list(index.missing)

    def batches(self) -> Iterator[list[PlainMessage]]:
        """Yield all messages in batches: those of one chunk, or of a part of a large chunk."""
        for place in self._index.places:
            yield from self._read(place)
            self._on_progress(place.offset)
        if sentence := self._index.unaccounted():
            note_missing(self.lost, sentence)

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments, one at a time in memory."""
        behind = 0
        for offset in sorted(self._index.attachments):
            try:
                if offset < behind:
                    raise Damaged("it overlaps another attachment")
                _, length = read_record_head(self._file, offset)
                behind = offset + length
                attachment = read_attachment(self._file, offset)
            except Damaged as damage:
                self._index.limit_reached |= isinstance(damage, BeyondLimit)
                note_missing(self.lost, f"the attachment at byte {offset} is lost: {damage}")
            else:
                yield attachment

    def _read(self, place: Place) -> Iterator[list[PlainMessage]]:
        source = PlaceReader(self._open_file, place, self._names, ALWAYS)
        messages: list[PlainMessage] = []
        size = 0
        try:
            for message in source.plain_messages():
                messages.append(message)
                size += len(message[1])
                if size >= _BATCH_BYTES:
                    yield messages
                    messages, size = [], 0
        except Damaged as damage:
            self._index.limit_reached |= isinstance(damage, BeyondLimit)
            end = place.offset + place.length
            note_missing(self.lost, f"bytes {place.offset} to {end} are lost: {damage}")
        if messages:
            yield messages
