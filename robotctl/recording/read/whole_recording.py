"""Reads a whole recording: each byte of its files, and all counts that the recording declares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from mcap.records import Channel

from robotctl.base.errors import UnreadableFile
from robotctl.recording.disk.access import size_of
from robotctl.recording.format.names import LEDGER_RECORD
from robotctl.recording.format.rosbag2 import (
    METADATA_RECORD,
    message_counts_in,
    topic_counts_in,
    total_count_in,
)
from robotctl.recording.format.topics import LATCHED_QOS, read_ledger
from robotctl.recording.read.files import absent_files, metadata_of_folder, recording_files
from robotctl.recording.read.seal_chain import Chain, check_chain
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.whole_data import FileState, WholeData
from robotctl.recording.read.whole_file import WholeFile, read_whole_file

_TopicKey = tuple[str, str]
"""Name and type of a topic."""


class RecordingProof(StrEnum):
    """What is proved about a recording, the most severe result first."""

    BROKEN = "broken"
    """A byte, a count, the chain or a signature is wrong."""

    UNREADABLE = "unreadable"
    """Not everything could be read."""

    WHOLE = "whole"
    """No contradiction was found, but not every file is sealed."""

    SEALED = "sealed"


@dataclass(frozen=True, slots=True)
class VerifiedRecording:
    """What reading every byte of a recording found, and its seals.

    `unreadable` has a sentence for each file that is missing or is no MCAP file, and for each part
    that was not read. `flaws` has a sentence for each wrong byte, and for each count that
    contradicts another.
    """

    path: Path
    files: tuple[WholeFile, ...]
    unreadable: tuple[str, ...]
    flaws: tuple[str, ...]
    chain: Chain

    @property
    def wrong(self) -> tuple[str, ...]:
        """A sentence for everything that is wrong: bytes, counts, seals, chain."""
        many = len(self.files) > 1
        seals = [
            f"{file.path.name}: {sentence}" if many else sentence
            for file in self.files
            for sentence in file.seal.wrong
        ]
        return (*self.flaws, *seals, *self.chain.wrong)

    @property
    def proof(self) -> RecordingProof:
        """The most severe result that was found."""
        if self.wrong:
            return RecordingProof.BROKEN
        if self.unreadable:
            return RecordingProof.UNREADABLE
        sealed = all(file.seal.state is SealState.SEALED for file in self.files)
        return RecordingProof.SEALED if sealed else RecordingProof.WHOLE


def verify_recording(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> VerifiedRecording:
    """Read every byte of a recording, a file or a folder, and check its seals.

    `on_progress` gets bytes done and in total.

    Raises:
        UnreadableFile: `path` holds no MCAP file.
    """
    text, problems = metadata_of_folder(path)
    paths = recording_files(path)
    whole_folder = paths != [path]
    unreadable = problems + absent_files(text, paths) if whole_folder else []
    sizes = [size_of(each) for each in paths]
    files: list[WholeFile] = []
    for number, each in enumerate(paths):
        before, total = sum(sizes[:number]), sum(sizes)
        try:
            files.append(
                read_whole_file(each, lambda done, _, b=before, t=total: on_progress(b + done, t))  # type: ignore[misc]
            )
        except UnreadableFile as error:
            unreadable.append(str(error))
    flaws: list[str] = []
    for file in files:
        prefix = f"{file.path.name}: " if whole_folder else ""
        flaws += [prefix + sentence for sentence in file.flaw_sentences()]
        if file.data.unread:
            unreadable.append(prefix + file.data.unread)
        if not file.flaws.count and not file.data.unread and file.data.own:
            flaws += [prefix + sentence for sentence in _miscounted(file)]
    if not flaws and not unreadable:
        flaws += _contradictions(text, files, whole_folder=whole_folder)
    return VerifiedRecording(
        path, tuple(files), tuple(unreadable), tuple(flaws), check_chain(files)
    )


def _miscounted(file: WholeFile) -> Iterator[str]:
    """Yield a sentence for each count of a rosbag2 record that the messages contradict."""
    texts = [r.metadata for r in file.data.metadata if r.name == METADATA_RECORD]
    if file.state is FileState.FINISHED and texts:
        told = topic_counts_in(texts[-1].get("serialized_metadata", ""))
        yield from _differences("its rosbag2 record", told, _counts([file.data]))


def _contradictions(text: str, files: Sequence[WholeFile], *, whole_folder: bool) -> Iterator[str]:
    """Yield a sentence for each count of `metadata.yaml` or a ledger that the files contradict."""
    own = [file for file in files if file.data.own and file.state is not FileState.CLIP]
    if len(own) != len(files) or not files:
        return
    told = message_counts_in(text)
    grows = {FileState.LIVE, FileState.NOT_CLOSED}
    is_older = any(file.state in grows for file in files)
    for file in files:
        count = told.get(file.path.name)
        found = file.data.message_count
        if count is None or count == found:
            continue
        if file.state in grows | {FileState.REPAIRED} and count < found:
            is_older = True  # a repair writes the list last, and may have been killed before
            continue
        yield f"metadata.yaml counts {count} messages in {file.path.name}, and {found} are there"
    complete = whole_folder and set(told) == {file.path.name for file in files}
    if complete and not is_older:
        found_by_topic = _counts([file.data for file in files])
        yield from _differences("metadata.yaml", topic_counts_in(text), found_by_topic)
        total, there = total_count_in(text), sum(found_by_topic.values())
        if total != there:
            yield f"metadata.yaml counts {total} messages, and {there} are there"
    yield from _ledger_differences(files)


def _ledger_differences(files: Sequence[WholeFile]) -> Iterator[str]:
    """Yield a sentence for each ledger count that the files up to the ledger's contradict."""
    first = files[0].path.stem
    names = [f"{first.removesuffix('0')}{number}" for number in range(len(files))]
    if not first.endswith("_0") or [file.path.stem for file in files] != names:
        return  # earlier files were removed
    for number, file in enumerate(files, start=1):
        if file.state is not FileState.FINISHED:
            return
        record = next(r for r in file.data.metadata if r.name == LEDGER_RECORD)
        ledger = read_ledger({LEDGER_RECORD: record.metadata})
        found = _counts([each.data for each in files[:number]])
        latched = _latched([each.data for each in files[:number]]) if number > 1 else set()
        for (name, kind), count in found.items():
            counts = ledger.get(f"{name} ({kind})") or ledger.get(name)
            told = None if counts is None else counts.get("written", 0)
            # A later file repeats the latched messages.
            if told is None or told > count or (told < count and (name, kind) not in latched):
                ledger_of = f"the ledger of {file.path.name}"
                yield f"{ledger_of} counts {told or 0} messages of {name}, and {count} are there"


def _differences(
    who: str, told: Mapping[_TopicKey, int], found: Mapping[_TopicKey, int]
) -> Iterator[str]:
    for key in sorted({*told, *found}):
        if told.get(key, 0) != found.get(key, 0):
            count, there = told.get(key, 0), found.get(key, 0)
            yield f"{who} counts {count} messages of {key[0]}, and {there} are there"


def _counts(parts: Sequence[WholeData]) -> dict[_TopicKey, int]:
    counts: Counter[_TopicKey] = Counter()
    for data in parts:
        for key, channel in data.channels.items():
            counts[_key(data, channel)] += data.counts.get(key, 0)
    return dict(counts)


def _latched(parts: Sequence[WholeData]) -> set[_TopicKey]:
    return {
        _key(data, channel)
        for data in parts
        for channel in data.channels.values()
        if LATCHED_QOS in channel.metadata.get("offered_qos_profiles", "")
    }


def _key(data: WholeData, channel: Channel) -> _TopicKey:
    schema = data.schemas.get(channel.schema_id)
    return channel.topic, schema.name if schema else ""
