"""Writes the files of a converted recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mcap.records import Attachment, Metadata

from robotctl.recording.convert.channel_table import ChannelTable
from robotctl.recording.disk.storage import DiskFile
from robotctl.recording.format.names import LIBRARY, Compression
from robotctl.recording.format.records import PlainMessage
from robotctl.recording.format.rosbag2 import METADATA_RECORD, BagFile, serialized_metadata
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile


class OutputFile:
    """One file of the converted recording. Every method may raise OSError."""

    def __init__(
        self, path: Path, table: ChannelTable, compression: Compression, profile: str, origin: str
    ) -> None:
        """Create the file; `origin` is the program that wrote the source."""
        self._path = path
        self._table = table
        self._storage = DiskFile(path)
        library = f"{LIBRARY}, converted from {origin}"
        self._mcap = McapFile(self._storage, profile=profile, library=library)
        self._encoder = ChunkEncoder(compression, 1)
        self._schemas = 0
        self._channels = 0

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self._mcap.size

    @property
    def has_messages(self) -> bool:
        """Whether it holds any."""
        return bool(self._mcap.summary.counts)

    def write(self, messages: Sequence[PlainMessage]) -> None:
        """Write messages as one chunk."""
        self._announce()
        self._mcap.commit(self._encoder.encode(pack(messages)), finished=False)

    def add_metadata(self, records: Sequence[Metadata]) -> None:
        """Add records."""
        for record in records:
            self._mcap.add_metadata(record.name, record.metadata)

    def add_attachment(self, attachment: Attachment) -> None:
        """Write an attachment."""
        self._mcap.add_attachment(attachment)
        self._mcap.commit(finished=False)  # one at a time in memory

    def finish(self, ledger: Sequence[Metadata]) -> BagFile:
        """Write the end of the file, with the ledger last; return its entry in `metadata.yaml`."""
        self._announce()
        summary = self._mcap.summary
        described = BagFile(self._path.name, summary.start_ns, summary.end_ns, dict(summary.counts))
        text = serialized_metadata(self._table.topics, [described])
        self._mcap.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
        self.add_metadata(ledger)
        self._mcap.commit()
        self.close()
        return described

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        self._storage.close()

    def _announce(self) -> None:
        """Add the schemas and channels that are new to the file."""
        for schema in self._table.schemas[self._schemas :]:
            self._mcap.add_schema(schema)
        for channel in self._table.channels[self._channels :]:
            self._mcap.add_channel(channel)
        self._schemas, self._channels = len(self._table.schemas), len(self._table.channels)
