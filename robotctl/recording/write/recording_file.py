"""One file of a recording: messages, their topics, and metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from mcap.records import Channel, Schema

from robotctl.recording.disk.access import share_with_group
from robotctl.recording.format.names import (
    EVENT_RECORD,
    INFO_RECORD,
    LEDGER_RECORD,
    LIBRARY,
    PROFILE,
)
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.format.rosbag2 import METADATA_RECORD, BagFile, serialized_metadata
from robotctl.recording.format.topics import ledger_values
from robotctl.recording.write.buffer import ChunkEncoder, PackedMessages
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.file_seal import FileSeal
from robotctl.recording.write.mcap_writer import McapFile
from robotctl.recording.write.recorder_options import RecorderOptions


class RecordingFile:
    """Writer of one file. Not thread-safe.

    `channels` may grow; the id of a channel is its position in `channels`. Every method may raise
    OSError; after that only `abandon` may be called.
    """

    def __init__(
        self,
        path: Path,
        options: RecorderOptions,
        metadata: Mapping[str, str],
        channels: Sequence[ChannelState],
    ) -> None:
        """Create the file and sync it, so that it is valid. After an error there is no file."""
        self.path = path
        self._channels = channels
        self._encoder = ChunkEncoder(options.compression, options.compression_level)
        self._announced = 0
        self._schemas: dict[tuple[str, str], int] = {}
        self._synced = False
        self._finished = False
        self.event_count = 0
        self.seal = None if options.sealer is None else FileSeal(options.sealer)
        """The seal of the file; None if it is not to be sealed."""

        storage = options.open_file(path)
        self._mcap = McapFile(
            storage, profile=PROFILE, library=LIBRARY, seal=self.seal, keeps_room=True
        )
        try:
            if options.group_readable:
                share_with_group(path)
            self._mcap.add_metadata(INFO_RECORD, metadata)
            for name, values in options.records.items():
                self._mcap.add_metadata(name, values)
            self._add_bag_metadata()
            self._mcap.commit()
            self._mcap.sync()
        except BaseException:
            with suppress(OSError):
                self._mcap.close()
            with suppress(OSError):
                path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes of the file, without the room between data and trailer."""
        return self._mcap.size

    @property
    def holds_messages(self) -> bool:
        """Whether the file has any message."""
        return bool(self._mcap.summary.counts)

    @property
    def index_bytes(self) -> int:
        """Size of the chunk index in the summary [bytes]; it grows with the number of chunks."""
        return self._mcap.summary.index_bytes

    @property
    def trailer_bytes(self) -> int:
        """Bytes of trailers written so far."""
        return self._mcap.trailer_bytes

    def begin_seal(self) -> None:
        """Begin the seal, in the writer thread: this may import a library and sync a file."""
        if self.seal is not None:
            self._mcap.add_sealed(self.seal.open(self.path.name))
            self._mcap.commit()
            self._synced = False

    def write(self, packed: PackedMessages) -> None:
        """Write `packed` as a chunk.

        Raises:
            OutOfMemory: There is no memory for the chunk; the file is unchanged.
        """
        chunk = self._encoder.encode(packed)
        self._announce_topics()
        self._mcap.commit(chunk)
        self._synced = False

    def write_topics(self) -> None:
        """Write the topics that were added, even if they have no messages yet."""
        if self._announce_topics():
            self._mcap.commit()
            self._synced = False

    def write_event(self, event: RecordedEvent) -> None:
        """Write an event into the metadata."""
        self._mcap.add_metadata(EVENT_RECORD, event.values())
        self._mcap.commit()
        self._synced = False
        self.event_count += 1

    def sync(self) -> None:
        """Force the written data to the disk."""
        if not self._synced:
            self._mcap.sync()
            self._synced = True
            if self.seal is not None:
                self.seal.keep()

    def finish(self) -> None:
        """Write the final metadata, and close the file."""
        self._announce_topics()
        self._add_bag_metadata()
        topics = [state.stats() for state in self._channels[: self._announced]]
        self._mcap.add_metadata(LEDGER_RECORD, ledger_values(topics))
        self._mcap.commit()
        self._mcap.sync()
        self._finished = True
        self._mcap.close()
        if self.seal is not None:
            self.seal.keep(closed=True)

    def abandon(self) -> None:
        """Restore the file to its state after the last good write. Call it after an OSError."""
        if self._finished:
            return
        self._finished = True
        try:
            self._mcap.cut_back()
        finally:
            self._mcap.close()

    def describe(self) -> BagFile:
        """Return the entry of the file in `metadata.yaml`."""
        summary = self._mcap.summary
        return BagFile(self.path.name, summary.start_ns, summary.end_ns, dict(summary.counts))

    def _announce_topics(self) -> bool:
        """Add schema and channel of each new topic of the file; return False if there is none."""
        known = len(self._channels)
        if self._announced == known:
            return False
        for channel in range(self._announced, known):
            topic = self._channels[channel].topic
            key = topic.type_name, topic.definition
            if key not in self._schemas:
                self._schemas[key] = len(self._schemas) + 1
                self._mcap.add_schema(
                    Schema(
                        id=self._schemas[key],
                        name=topic.type_name,
                        encoding="ros2msg" if topic.definition else "",
                        data=topic.definition.encode(),
                    )
                )
            self._mcap.add_channel(
                Channel(
                    id=channel,
                    topic=topic.name,
                    message_encoding=topic.encoding,
                    schema_id=self._schemas[key],
                    metadata={
                        "topic_type_hash": topic.type_hash,
                        "offered_qos_profiles": topic.offered_qos,
                    },
                )
            )
        self._announced = known
        return True

    def _add_bag_metadata(self) -> None:
        topics = [state.topic for state in self._channels[: self._announced]]
        text = serialized_metadata(topics, [self.describe()])
        self._mcap.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
