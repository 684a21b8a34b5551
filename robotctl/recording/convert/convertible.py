"""What a conversion reads: the files of a recording, whatever their storage is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.recording.format.records import PlainMessage


class ConvertibleFile(Protocol):
    """One file of a recording, open for one pass."""

    name: str
    profile: str
    library: str
    """The program that wrote it."""

    lost: list[str]
    """What cannot be read, one sentence each; complete after the pass."""

    def channels(self) -> Sequence[tuple[Channel, Schema | None]]:
        """Return the channels, with the ids that the messages name."""

    def metadata(self) -> Sequence[Metadata]:
        """Return the metadata records in their order."""

    def batches(self) -> Iterator[Sequence[PlainMessage]]:
        """Yield the messages in batches; each batch is written as one chunk."""

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments, after the messages."""
