"""Cut clips, self-contained files, from a recording.

A clip begins with the journal since its last snapshot, and the last latched messages.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
from mcap.records import Metadata

from robotctl.base.errors import Refused
from robotctl.base.processes import Report
from robotctl.base.store import RemoteFile
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.disk import is_shared, make_folder, new_file, share_like
from robotctl.recording.format.names import (
    CLIP_RECORD,
    EVENT_RECORD,
    LEDGER_RECORD,
    LIBRARY,
    OBSERVING,
    RECOVERY_RECORD,
    Compression,
    EventKind,
)
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.format.rosbag2 import METADATA_RECORD, BagFile, serialized_metadata
from robotctl.recording.format.topics import Topic
from robotctl.recording.keep.listing import CLIPS_FOLDER, ListedRecording, list_recording
from robotctl.recording.read.file_index import OF_EACH_FILE, note_missing, topic_of
from robotctl.recording.read.journal_reader import since_snapshot
from robotctl.recording.read.messages import Message, Window, batched
from robotctl.recording.read.reader import Recording
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.channel_state import MAX_LATCHED
from robotctl.recording.write.mcap_writer import McapFile

_OF_THE_WHOLE = (METADATA_RECORD, LEDGER_RECORD, RECOVERY_RECORD, EVENT_RECORD, CLIP_RECORD)
"""Metadata of a whole recording, wrong for a part of it."""


def records_of_clip(
    recorded: Iterable[Metadata], window: Window
) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield name and values of each metadata record for a clip of `window`."""
    records = list(recorded)
    for record in records:
        if record.name not in (*_OF_THE_WHOLE, *OF_EACH_FILE):
            yield record.name, record.metadata
    last = {record.name: record.metadata for record in records}
    for name in OF_EACH_FILE:  # each file repeats these; the mode may change within the clip
        if name in last:
            yield name, {k: v for k, v in last[name].items() if k != "mode" or v == OBSERVING}
    for event in events_in(records):
        if window[0] <= event.log_ns <= window[1]:
            yield EVENT_RECORD, event.values()


CHUNK_BYTES = 1 << 20

Lose = Callable[[str], None]
"""Called with a sentence about a part that cannot be read."""

Progress = Callable[[int, int], None]
"""Called with the recorded time done and in total [ns]."""


@dataclass(frozen=True, slots=True)
class Moment:
    """The subject of a clip, an event of the recording or, if `kind` is None, a time."""

    log_ns: int
    kind: EventKind | None = None
    text: str = ""

    @classmethod
    def of(cls, event: RecordedEvent) -> Moment:
        """Return the subject of a clip about `event`."""
        return cls(event.log_ns, event.kind, event.text)


@dataclass(frozen=True, slots=True)
class Clip:
    """A finished clip. `lost` has a sentence per unreadable part.

    `start_ns` and `end_ns` [ns since the epoch] lie within the recording. `message_count` includes
    the earlier journal and latched messages with which the clip begins.
    """

    target: Path
    moment: Moment
    start_ns: int
    end_ns: int
    message_count: int
    lost: tuple[str, ...]


def cut_clip(
    recording: Recording,
    moment: Moment,
    window: Window,
    target: Path,
    on_progress: Progress = lambda done, total: None,
) -> Clip:
    """Copy the messages in `window` (ns, both ends included) into the new file `target`.

    Raises:
        Refused: Nothing was recorded in the window, or `target` exists or cannot be written. No new
            file remains.
    """
    info = recording.info()
    start_ns, end_ns = max(window[0], info.start_ns), min(window[1], info.end_ns)
    if not info.message_count or start_ns > end_ns:
        raise Refused(f"{recording.path} has no messages in that time range")
    lost = list(recording.missing)
    with new_file(target) as storage:
        mcap = McapFile(storage, profile=info.profile, library=LIBRARY)
        window = start_ns, end_ns
        count = _write_clip(recording, moment, window, mcap, target.name, lost, on_progress)
        share_like(target, recording.path)
    return Clip(target, moment, start_ns, end_ns, count, tuple(lost))


def clip_messages(recording: Recording, window: Window, lose: Lose) -> Iterator[Message]:
    """Yield earlier journal and latched messages, then all in `window` (ns, ends included)."""
    yield from _before(recording, window[0], lose)
    yield from recording.messages(None, lose, window)


def _before(recording: Recording, start_ns: int, lose: Lose) -> Iterator[Message]:
    """Yield the journal since its last snapshot, then latched messages with log time `start_ns`."""
    yield from since_snapshot(recording, start_ns, lose)
    channels = recording.channels().items()
    topics = [topic_of(channel, type_name) for (_, type_name), (channel, _) in channels]
    latched = {topic.name: MAX_LATCHED for topic in topics if topic.latched}
    found: dict[tuple[str, bytes, int, int], Message] = {}
    for message in recording.last_before(start_ns, latched, lose):
        sent = message.topic, message.data, message.publish_ns, message.sequence
        found.pop(sent, None)  # a new file repeats it, with an older log time if the recorder lags
        found[sent] = message._replace(log_ns=start_ns)
    yield from found.values()


def _write_clip(
    recording: Recording,
    moment: Moment,
    window: Window,
    mcap: McapFile,
    name: str,
    lost: list[str],
    on_progress: Progress,
) -> int:
    """Write the clip, add losses to `lost`, and return the number of messages.

    Raises:
        OSError: The disk is full or fails.
        Refused: The clip would be empty.
    """
    start_ns, end_ns = window
    encoder = ChunkEncoder(Compression.ZSTD, 1)
    ids: dict[tuple[str, str], int] = {}
    topics: list[Topic] = []

    def lose(sentence: str) -> None:
        if sentence not in lost:
            note_missing(lost, sentence)

    def write(messages: Iterable[Message]) -> int:
        plain = ((ids[each.topic, each.type_name], each.data, *each[3:]) for each in messages)
        count = 0
        for batch in batched(plain, CHUNK_BYTES):
            mcap.commit(encoder.encode(pack(batch)), finished=False)
            count += len(batch)
        return count

    def told(messages: Iterable[Message]) -> Iterator[Message]:
        for message in messages:
            yield message
            on_progress(message.log_ns - start_ns, end_ns - start_ns)

    for record, values in records_of_clip(recording.metadata(), window):
        mcap.add_metadata(record, values)
    for number, (key, (channel, schema)) in enumerate(recording.channels().items()):
        ids[key] = number
        if schema is not None:
            mcap.add_schema(replace(schema, id=number + 1))
        schema_id = 0 if schema is None else number + 1
        mcap.add_channel(replace(channel, id=number, schema_id=schema_id))
        topics.append(topic_of(channel, key[1]))
    before = write(_before(recording, start_ns, lose))
    during = write(told(recording.messages(None, lose, window)))
    if not during:
        raise Refused(f"{recording.path} has no messages in that time range")
    about = {
        "of": ", ".join(path.name for path in recording.info().files),
        "event": "" if moment.kind is None else moment.kind.value,
        "event_ns": str(moment.log_ns),
        "text": moment.text,
        "start_ns": str(start_ns),
        "end_ns": str(end_ns),
        "lost": "\n".join(lost),
    }
    mcap.add_metadata(CLIP_RECORD, about)
    summary = mcap.summary
    bag_file = BagFile(name, summary.start_ns, summary.end_ns, dict(summary.counts))
    text = serialized_metadata(topics, [bag_file])
    mcap.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
    mcap.commit()
    mcap.sync()
    return before + during


PATIENCE_S = 3.0
"""Maximum delay of messages of a live recording."""

_LOOK_AGAIN_S = 0.1


@dataclass(frozen=True, slots=True)
class ClipJob:
    """A clip to cut from `source` into `target`, by default in the recording's clips folder."""

    source: Path
    moment: Moment
    before_s: float
    after_s: float
    target: Path | None = None

    @property
    def end_ns(self) -> int:
        """End of the clip [ns since the epoch]."""
        return self.moment.log_ns + round(self.after_s * NS_PER_S)


def remaining_s(job: ClipJob, listed: ListedRecording) -> float:
    """Return the time until the end of the clip [s], 0 if nothing more is recorded for it."""
    if not listed.live or listed.end_ns >= job.end_ns:
        return 0.0
    return max(job.end_ns - time.time_ns(), 0) / NS_PER_S


def make_clip(job: ClipJob, on_progress: Progress = lambda done, total: None) -> Clip:
    """Wait for the messages of the clip, at most PATIENCE_S after they are due, and cut it.

    Raises:
        Refused: There is nothing to cut, or the clip cannot be written.
        UnreadableFile: The recording cannot be read.
    """
    _wait_for_end(job)
    target = job.target or _free_name(job)
    with Recording(job.source) as recording:
        return cut_clip(
            recording,
            job.moment,
            (max(job.moment.log_ns - round(job.before_s * NS_PER_S), 0), job.end_ns),
            target,
            on_progress,
        )


def clip_job(given: dict[str, Any], report: Report) -> None:
    """Cut the clip of the ClipJob `given`, and report the result. Called in a new process."""
    made = make_clip(msgspec.convert(given, ClipJob, dec_hook=lambda kind, value: kind(value)))
    report({"target": str(made.target), "lost": list(made.lost)})


def _wait_for_end(job: ClipJob) -> None:
    due_s = min((job.end_ns - time.time_ns()) / NS_PER_S, job.after_s)  # the clock may be set back
    deadline = time.monotonic() + due_s + PATIENCE_S
    while time.monotonic() < deadline:
        listed = list_recording(job.source)
        if not listed.live or listed.end_ns >= job.end_ns:
            return
        time.sleep(_LOOK_AGAIN_S)


def _free_name(job: ClipJob) -> Path:
    """Return an unused path in the recording's clips folder, which is created if missing."""
    source = job.source
    folder = (source if source.is_dir() else source.parent) / CLIPS_FOLDER
    if isinstance(source, RemoteFile):
        folder = Path()  # the working directory
    try:
        if not folder.is_dir():
            make_folder(folder, shared=is_shared(folder.parent))
    except OSError as error:
        raise Refused(
            f"cannot write into {folder}: {error.strerror} (choose another file: -o FILE)"
        ) from error
    at = time.strftime("%H%M%S", time.localtime(job.moment.log_ns // NS_PER_S))
    kind = "at" if job.moment.kind is None else job.moment.kind.value
    name, attempt = f"{source.stem}_{kind}_{at}", 1
    target = folder / f"{name}.mcap"
    while os.path.lexists(target):
        attempt += 1
        target = folder / f"{name}-{attempt}.mcap"
    return target
