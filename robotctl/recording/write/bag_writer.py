"""Write the files of one recording folder in rosbag2's layout.

The event loop creates the BagWriter and reads its properties. The writer thread calls the rest.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from typing import Final

from mcap.records import Channel, Schema

from robotctl.base.errors import Refused
from robotctl.recording.format.disk import cure_of, make_folder, reason_of, share_with_group
from robotctl.recording.format.names import (
    EVENT_RECORD,
    INFO_RECORD,
    LEDGER_RECORD,
    LIBRARY,
    PROFILE,
)
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.format.records import PlainMessage
from robotctl.recording.format.rosbag2 import (
    METADATA_RECORD,
    BagFile,
    serialized_metadata,
    write_metadata,
)
from robotctl.recording.format.topics import ledger_values
from robotctl.recording.format.trailer import Summary
from robotctl.recording.write.buffer import ChunkEncoder, OutOfMemory, PackedMessages, pack
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.mcap_writer import FileSeal, McapFile
from robotctl.recording.write.recorder_options import RecorderOptions


class RecordingFile:
    """Writer of one file. Not thread-safe.

    `channels` may grow. The position of a channel is its id. Every method may raise OSError; only
    `abandon` may be called afterwards.
    """

    def __init__(
        self,
        path: Path,
        options: RecorderOptions,
        metadata: Mapping[str, str],
        channels: Sequence[ChannelState],
    ) -> None:
        """Create a valid file on the disk. After an error there is no file."""
        self.path = path
        self._channels = channels
        self._encoder = ChunkEncoder(options.compression, options.compression_level)
        self._announced = 0
        self._schemas: dict[tuple[str, str], int] = {}
        self._synced = False
        self._finished = False
        self.event_count = 0
        self.seal = None if options.sealer is None else FileSeal(options.sealer)
        """The seal of the file, or None."""

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
        """Bytes of the file, without the free room in it."""
        return self._mcap.size

    @property
    def summary(self) -> Summary:
        """The MCAP summary of the data written so far: counts, times and indexes."""
        return self._mcap.summary

    def begin_seal(self) -> None:
        """Begin to seal the file. Slow, as this may import a library and sync a file."""
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
        """Write the topics that were added to `channels`, even without messages."""
        if self._announce_topics():
            self._mcap.commit()
            self._synced = False

    def write_event(self, event: RecordedEvent) -> None:
        """Write an event as a metadata record."""
        self._mcap.add_metadata(EVENT_RECORD, event.values())
        self._mcap.commit()
        self._synced = False
        self.event_count += 1

    def sync(self) -> None:
        """Sync the written data to the disk. Then store the seal's last link outside the file."""
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
        """Add schema and channel of each new topic, and return whether there was one."""
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


MAX_SHARE: Final = 0.25
"""Maximum share of a file for repeated latched messages."""


def repeats(
    channels: Sequence[ChannelState], newest_ns: int, split_bytes: int
) -> list[PlainMessage]:
    """Return the latched messages that a new file repeats at its beginning.

    `newest_ns` replaces their log times unless it is 0. If they need more than MAX_SHARE of
    `split_bytes`, the largest are left out and counted in `not_repeated`.
    """
    latched = [
        (channel, message.data, newest_ns or message.log_ns, message.publish_ns, message.sequence)
        for channel, state in enumerate(channels)
        for message in state.latched_messages()
    ]
    left = round(split_bytes * MAX_SHARE)
    fits = [False] * len(latched)
    for position in sorted(range(len(latched)), key=lambda each: len(latched[each][1])):
        left -= len(latched[position][1])
        fits[position] = left >= 0
        if left < 0:
            channels[latched[position][0]].not_repeated += 1
    return [message for message, fit in zip(latched, fits, strict=True) if fit]


METADATA_PERIOD_S = 10.0
"""Maximum age of the counts in `metadata.yaml`."""

MAX_EVENTS = 1000
"""Maximum number of events per file. Each event rewrites the list of all of them."""

MAX_INDEX_BYTES = 8 << 20
"""Maximum size of the chunk index of a file. Each chunk adds 10 bytes for each topic in it."""


class BagWriter:
    """Writer of the files of one folder. Not thread-safe.

    `channels` may grow. The position of a channel is its id. Every method may raise OSError; only
    `abandon` may be called afterwards.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions,
        metadata: Callable[[], Mapping[str, str]],
        channels: Sequence[ChannelState],
        on_split: Callable[[Path], None] = lambda path: None,
        on_full: Callable[[Path], None] | None = None,
    ) -> None:
        """Create the first file in `folder`, which must exist.

        `metadata` returns the values to store in each new file. `on_split` gets the path of each
        later file. `on_full` gets the path of each full file; without it, the next file begins.
        """
        self._folder = folder
        self._options = options
        self._metadata = metadata
        self._channels = channels
        self._on_split = on_split
        self._on_full = on_full
        self._told_full = False
        self._finished: list[BagFile] = []
        self._finished_bytes = 0
        self._newest_ns = 0
        """Highest log time in the last chunk [ns]; it steps back if the clock was set back."""

        self._space_warning = ""
        self.check_space()
        self._listed_topics = 0
        self._metadata_due = 0.0
        self._files_begun = 0
        self._begun = time.monotonic()
        self._file = self._new_file()
        self.path = self._file.path
        """The current file."""

        self._write_metadata()

    @property
    def warning(self) -> str:
        """A sentence about low disk space or a failed seal, or ""."""
        seal = self._file.seal
        return "; ".join(filter(None, [self._space_warning, "" if seal is None else seal.failure]))

    @property
    def size(self) -> int:
        """Bytes of all files, without the free room in the current file."""
        return self._finished_bytes + self._file.size

    def write(self, packed: PackedMessages) -> None:
        """Write `packed` as a chunk, and count its messages as written.

        Raises:
            OutOfMemory: The chunk is not written; the next chunk may succeed.
        """
        self._replace_full()
        self._file.write(packed)
        self._newest_ns = packed.end_ns
        for channel, index in packed.indexes.items():
            self._channels[channel].written += len(index) // 2

    def begin_seal(self) -> None:
        """Begin to seal the first file. Later files are sealed from their beginning."""
        self._file.begin_seal()

    def write_topics(self) -> None:
        """Write the topics added since the last call, even without messages."""
        self._file.write_topics()

    def write_event(self, event: RecordedEvent) -> None:
        """Write `event` into the metadata of the current file."""
        self._replace_full()
        self._file.write_event(event)

    def sync(self) -> None:
        """Force the written data to the disk."""
        self._file.sync()

    def split(self) -> None:
        """Continue in a new file, which repeats the latched messages."""
        self._file.finish()  # first, because the seal of the successor continues its seal
        successor = self._new_file()
        self._finished.append(self._file.describe())
        self._finished_bytes += self._file.size
        self._file = successor
        self._begun = time.monotonic()
        self._told_full = False
        self._file.begin_seal()
        messages = repeats(self._channels, self._newest_ns, self._options.split_bytes)
        try:
            if messages:
                self._file.write(pack(messages))
        except OutOfMemory:
            for channel, *_ in messages:
                self._channels[channel].not_repeated += 1
        self._write_metadata()
        self.path = successor.path
        with suppress(Exception):  # a failing listener must not stop the recording
            self._on_split(successor.path)

    def check_space(self) -> None:
        """Set or clear the warning about low disk space.

        Raises:
            OSError: Less than `stop_free_bytes` are left.
        """
        free = self._options.free_space(self._folder)
        stop, warn = self._options.stop_free_bytes, self._options.warn_free_bytes
        self._space_warning = ""
        if free < stop:
            raise OSError(errno.ENOSPC, f"only {_mb(free)} left on the disk, {_mb(stop)} stay free")
        if free < warn:
            self._space_warning = f"{_mb(free)} left on the disk; recording stops at {_mb(stop)}"

    def list_new_topics(self) -> None:
        """Write `metadata.yaml` if there are new topics."""
        if len(self._channels) > self._listed_topics:
            self._write_metadata()

    def refresh_metadata(self) -> None:
        """Write `metadata.yaml` if it is older than METADATA_PERIOD_S or lists a removed file."""
        # Retention removes the oldest file first.
        removed = bool(self._finished) and not self._is_there(self._finished[0])
        if removed or time.monotonic() >= self._metadata_due:
            self._write_metadata()

    def close(self) -> None:
        """Finish the current file and `metadata.yaml`."""
        self._file.finish()
        self._write_metadata()

    def abandon(self) -> None:
        """Restore the file to its state after the last good write. Call it after an OSError."""
        self._file.abandon()
        with suppress(OSError):  # on a full disk the previous text stays
            self._write_metadata()

    def _replace_full(self) -> None:
        if self._told_full or not self._is_full():
            return
        if self._on_full is None:
            self.split()
        else:
            self._told_full = True
            self._on_full(self._file.path)

    def _is_full(self) -> bool:
        summary = self._file.summary
        if self._file.event_count >= MAX_EVENTS or summary.index_bytes >= MAX_INDEX_BYTES:
            return True
        age_s = time.monotonic() - self._begun
        is_due = self._file.size >= self._options.split_bytes or age_s >= self._options.split_s
        return is_due and bool(summary.counts)

    def _new_file(self) -> RecordingFile:
        while True:
            path = self._folder / f"{self._folder.name}_{self._files_begun}.mcap"
            self._files_begun += 1
            with suppress(FileExistsError):  # never overwrite a file
                return RecordingFile(path, self._options, self._metadata(), self._channels)

    def _write_metadata(self) -> None:
        topics = [state.topic for state in list(self._channels)]
        self._finished = [file for file in self._finished if self._is_there(file)]
        write_metadata(self._folder, topics, [*self._finished, self._file.describe()])
        self._listed_topics = len(topics)
        self._metadata_due = time.monotonic() + METADATA_PERIOD_S

    def _is_there(self, file: BagFile) -> bool:
        return (self._folder / file.name).exists()


def begin_bag(
    folder: Path,
    options: RecorderOptions,
    metadata: Callable[[], Mapping[str, str]],
    channels: Sequence[ChannelState],
    on_split: Callable[[Path], None],
    on_full: Callable[[Path], None] | None,
) -> BagWriter:
    """Create `folder`, and return its BagWriter.

    Raises:
        Refused: The folder cannot be written; if it was created, it is removed again.
    """
    created = False
    try:
        make_folder(folder, shared=options.group_readable)
        created = True
        return BagWriter(folder, options, metadata, channels, on_split, on_full)
    except OSError as error:
        if created:
            rmtree(folder, ignore_errors=True)
        raise Refused(
            f"cannot record into {folder}: {reason_of(error)}",
            f"{cure_of(error)}, or choose another folder (--recordings)",
        ) from error


def _mb(size: int) -> str:
    return f"{size / 1e6:.0f} MB"
