"""The options of a recorder, its filter of topics, and the rate of each topic."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import translate
from pathlib import Path

from robotctl.recording.format.disk import DiskFile, Storage
from robotctl.recording.format.names import Compression
from robotctl.recording.write.mcap_writer import Sealer

TYPE_PREFIX = "type:"
"""Prefix of a pattern for types instead of names."""


def is_plain_name(pattern: str) -> bool:
    """Return whether `pattern` is the full name of one topic, without wildcards."""
    return pattern.startswith("/") and not set(pattern) & set("*?[")


class TopicFilter:
    """Selects topics that match `include`, or any if it is empty, and do not match `exclude`.

    A pattern is a name with the wildcards `*`, `?` and `[...]`, or `type:` and such a pattern for
    the type. `*` also matches `/`. Topics in `always` are always selected.
    """

    def __init__(
        self, include: Iterable[str] = (), exclude: Iterable[str] = (), always: Iterable[str] = ()
    ) -> None:
        self._include = [TopicPattern(text) for text in include]
        self._exclude = [TopicPattern(text) for text in exclude]
        self._always = frozenset(always)

    def records(self, topic: str, type_name: str) -> bool:
        """Return whether the topic with this name and type is selected for recording."""
        if topic in self._always:
            return True
        if any(pattern.matches(topic, type_name) for pattern in self._exclude):
            return False
        included = (pattern.matches(topic, type_name) for pattern in self._include)
        return not self._include or any(included)

    def can_leave_out(self, topic: str) -> bool:
        """Return whether patterns may exclude `topic`: not if it is in `always`."""
        return topic not in self._always


class TopicPattern:
    """A pattern with wildcards for topic names or, after the prefix `type:`, for types."""

    def __init__(self, text: str) -> None:
        self._of_type = text.startswith(TYPE_PREFIX)
        self._match = re.compile(translate(text.removeprefix(TYPE_PREFIX))).match

    def matches(self, topic: str, type_name: str) -> bool:
        """Return whether the pattern matches `topic` or, if it begins with `type:`, `type_name`."""
        return self._match(type_name if self._of_type else topic) is not None


class RateByTopic:
    """The rates of topics [1/s] from texts such as `/camera/*=5`. The first match counts."""

    def __init__(self, texts: Iterable[str]) -> None:
        parts = (text.rpartition("=") for text in texts)
        self._rates = [(TopicPattern(pattern), float(rate)) for pattern, _, rate in parts]

    def of(self, topic: str, type_name: str) -> float | None:
        """Return the rate of a topic, None if no pattern matches it."""
        matching = (rate for pattern, rate in self._rates if pattern.matches(topic, type_name))
        return next(matching, None)


def free_space(folder: Path) -> int:
    """Return the free space for this user in `folder` [bytes].

    Raises:
        OSError: The folder cannot be examined.
    """
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """Sizes and times of the recorder.

    Messages are written when they fill `chunk_bytes`, at the latest after `flush_s`. A new file
    begins at `split_bytes` or after `split_s`.
    """

    compression: Compression = Compression.ZSTD
    compression_level: int = 1
    chunk_bytes: int = 1 << 20
    flush_s: float = 0.25
    sync_s: float = 1.0
    """Period of the syncs [s]. Synced data survives a power cut."""

    memory_bytes: int = 96 << 20
    """Memory for waiting and latched messages. Messages that do not fit are dropped and counted."""

    split_bytes: int = 256_000_000
    split_s: float = 600.0
    warn_free_bytes: int = 2_000_000_000
    stop_free_bytes: int = 500_000_000
    """The recorder stops below this free disk space, and warns below `warn_free_bytes`."""

    group_readable: bool = False
    """Whether the group may read the recording, and not only its owner."""

    records: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Further metadata records for the beginning of each file, by name."""

    sealer: Sealer | None = None
    evidence: frozenset[str] = frozenset()
    """Topics whose messages get separate chunks if the other topics have much more data."""

    open_file: Callable[[Path], Storage] = DiskFile
    free_space: Callable[[Path], int] = free_space
