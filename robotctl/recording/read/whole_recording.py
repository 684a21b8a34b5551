"""Read a whole recording, and check all bytes, seals and message counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Final

from mcap.records import Channel

from robotctl.base.errors import UnreadableFile
from robotctl.recording.format.names import LEDGER_RECORD
from robotctl.recording.format.rosbag2 import (
    METADATA_RECORD,
    message_counts_in,
    topic_counts_in,
    total_count_in,
)
from robotctl.recording.format.seal_records import Opening
from robotctl.recording.format.topics import LATCHED_QOS, read_ledger
from robotctl.recording.read.files import (
    SUFFIX,
    absent_files,
    each_with_progress,
    metadata_of_folder,
    recording_files,
)
from robotctl.recording.read.whole_data import FileState, WholeData
from robotctl.recording.read.whole_file import SealState, WholeFile, read_whole_file
from robotctl.recording.seal import KnownHeads

_TopicKey = tuple[str, str]
"""Name and type of a topic."""


MAX_MISSING: Final = 20
"""Maximum number of missing files in a `Chain`."""


@dataclass(slots=True)
class Chain:
    """The result of `check_chain`: sentences about contradictions (`wrong`) and gaps (`absent`)."""

    wrong: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    missing: list[tuple[str, int]] = field(default_factory=list)
    """Root key and file number of each file in a gap, at most MAX_MISSING."""


def check_chain(files: Iterable[WholeFile]) -> Chain:
    """Compare each sealed file with its predecessor in the chain, and return the findings."""
    chain = Chain()
    by_root: dict[str, list[tuple[Opening, WholeFile]]] = {}
    for file in files:
        opening = file.seal.opening
        if opening is not None and file.state is not FileState.CLIP:
            by_root.setdefault(opening.root, []).append((opening, file))
    for pairs in by_root.values():
        _compare(_without_copies(pairs), chain)
    return chain


def _without_copies(pairs: Sequence[tuple[Opening, WholeFile]]) -> list[tuple[Opening, WholeFile]]:
    """Return the files sorted by number, with a copy only if its original is not among them."""
    originals = {opening.number for opening, file in pairs if not file.seal.is_copy}
    copies = {opening.number: (opening, file) for opening, file in pairs if file.seal.is_copy}
    left = [pair for pair in pairs if not pair[1].seal.is_copy]
    left += [pair for number, pair in copies.items() if number not in originals]
    return sorted(left, key=lambda pair: pair[0].number)


def _compare(pairs: Sequence[tuple[Opening, WholeFile]], chain: Chain) -> None:
    for (opening, file), (following, next_file) in pairwise(pairs):
        name, next_name = file.path.name, next_file.path.name
        if following == opening and _are_alike(file, next_file):
            continue
        if following.number == opening.number:
            chain.wrong.append(f"{name} and {next_name} have the same place in the chain")
        elif following.number > opening.number + 1:
            first, last = opening.number + 1, following.number - 1
            which = f"file {first} is" if first == last else f"files {first} to {last} are"
            chain.absent.append(f"{which} not here, between {name} and {next_name}")
            room = MAX_MISSING - len(chain.missing)
            chain.missing += [
                (opening.root, n) for n in range(first, min(last, first + room - 1) + 1)
            ]
        elif following.previous_key != opening.key:
            chain.wrong.append(f"the key of {next_name} is not signed by that of {name}")
        elif following.previous_file != opening.file:
            chain.absent.append(f"{next_name} knows no end of {name}")
        elif not file.seal.is_copy and not file.seal.knows(following.previous):
            chain.wrong.append(
                f"{next_name} continues another end of {name}: "
                "that file was changed, or its tail was cut"
            )


def _are_alike(file: WholeFile, other: WholeFile) -> bool:
    """Return whether one file is a copy of the other in another folder, as `sync` makes them."""
    same_links = bool(file.seal.links) and file.seal.links == other.seal.links
    return same_links and file.path.name == other.path.name


def find_head(files: Iterable[WholeFile], digest: str) -> WholeFile | None:
    """Return the first file with a valid link of the hex `digest`, None without one."""
    return next((file for file in files if file.seal.knows(digest.lower())), None)


_AS_RECORDED: Final = (FileState.FINISHED, FileState.LIVE, FileState.NOT_CLOSED)
"""The states of a file as the recorder left it, with its seal."""


@dataclass(frozen=True, slots=True)
class KnownFile:
    """How a file differs from what this machine knows of it, in sentences."""

    wrong: str = ""
    """The reason against the known file, or ""."""

    unproved: str = ""
    """The part of the known seal lost in a repair or a conversion, or ""."""


def compare_known(file: WholeFile, heads: KnownHeads) -> KnownFile:
    """Compare a file's key, name and end with `heads`, what this machine knows of sealed files."""
    opening = file.seal.opening
    name = file.path.name.removesuffix(SUFFIX)
    if opening is None:
        if name not in heads.signed:
            return KnownFile()
        text = "this machine's list of keys knows a seal of it, which is not there"
        return KnownFile(text) if file.state in _AS_RECORDED else KnownFile(unproved=text)
    for known in (name, opening.file):
        if opening.key not in heads.keys.get(known, {opening.key}):
            return KnownFile(
                wrong=f"this machine's list of keys knows {known} with another key: it was "
                "replaced, or is of another robot of the same name"
            )
    closed = heads.closed.get(opening.key)
    if closed is None or file.seal.knows(closed.digest):
        return KnownFile()
    if file.seal.is_copy:
        return KnownFile(unproved="this machine knows its end, which no copy proves")
    return KnownFile(wrong="this machine knows another end of it: a tail was cut or changed")


class RecordingProof(StrEnum):
    """The result of verifying a recording, the most severe first."""

    BROKEN = "broken"
    """A byte, a count, the chain or a signature is wrong."""

    UNREADABLE = "unreadable"
    """Not everything could be read."""

    WHOLE = "whole"
    """No contradiction was found, but not every file is sealed."""

    SEALED = "sealed"


@dataclass(frozen=True, slots=True)
class VerifiedRecording:
    """The result of `verify_recording`. `unreadable` and `flaws` have sentences."""

    path: Path
    files: tuple[WholeFile, ...]
    unreadable: tuple[str, ...]
    flaws: tuple[str, ...]
    chain: Chain

    @property
    def wrong(self) -> tuple[str, ...]:
        """Sentences about the faults in bytes, message counts, seals and the chain of files."""
        many = len(self.files) > 1
        seals = [
            f"{file.path.name}: {sentence}" if many else sentence
            for file in self.files
            for sentence in file.seal.wrong
        ]
        return (*self.flaws, *seals, *self.chain.wrong)

    @property
    def proof(self) -> RecordingProof:
        """The result for the whole recording: the most severe one that applies."""
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

    Raises:
        UnreadableFile: `path` holds no MCAP file.
    """
    text, problems = metadata_of_folder(path)
    paths = recording_files(path)
    whole_folder = paths != [path]
    unreadable = problems + absent_files(text, paths) if whole_folder else []
    files: list[WholeFile] = []
    for each, tell in each_with_progress(paths, on_progress):
        try:
            files.append(read_whole_file(each, tell))
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
    """Yield a sentence for each wrong count in a rosbag2 record."""
    texts = [r.metadata for r in file.data.metadata if r.name == METADATA_RECORD]
    if file.state is FileState.FINISHED and texts:
        told = topic_counts_in(texts[-1].get("serialized_metadata", ""))
        yield from _differences("its rosbag2 record", told, _counts([file.data]))


def _contradictions(text: str, files: Sequence[WholeFile], *, whole_folder: bool) -> Iterator[str]:
    """Yield a sentence for each wrong count in `metadata.yaml` or a ledger."""
    own = [file for file in files if file.data.own and file.state is not FileState.CLIP]
    if len(own) != len(files) or not files:
        return
    told = message_counts_in(text)
    grows = {FileState.LIVE, FileState.NOT_CLOSED}
    is_older = any(file.state in grows for file in files)
    # A kill between the end of a file and the list leaves the list of the file's beginning.
    last = [*told][-1:] if total_count_in(text) == sum(told.values()) else []
    for file in files:
        count = told.get(file.path.name)
        found = file.data.message_count
        if count is None or count == found:
            continue
        may_be_older = file.state in grows | {FileState.REPAIRED} or [file.path.name] == last
        if may_be_older and count < found:
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
    """Yield a sentence for each wrong count in a ledger of the files."""
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
