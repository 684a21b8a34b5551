"""Stops the recording of the heaviest topics while the disk is almost full."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from robotctl.recording import Recorder
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import free_space

_log = logging.getLogger(__name__)

LOOK_S: Final = 2.0

STEP: Final = 0.1
"""One more topic is stopped each time that a further tenth of the reserve is used."""

REOPEN: Final = 1.1
"""Topics are recorded again when the free space is at least this many times the reserve."""

MAX_NAMED: Final = 10


class DiskReserve:
    """Stops recording topics, the heaviest first, while less than `least_bytes` are free.

    `gates` has the MessageGates of each topic that may be stopped. Use only in the loop's thread.
    """

    def __init__(self, least_bytes: int, gates: Mapping[str, Sequence[MessageGate]]) -> None:
        self._least_bytes = least_bytes
        self._gates = gates
        self._free_bytes = 0
        self._unknown = ""
        """Why the free space is unknown, or ""."""

        self._sizes: Mapping[str, int] = {}
        self.stopped: list[str] = []
        """Topics that are not recorded, in the order in which they were stopped."""

    async def run(
        self, recorder: Recorder, folder: Path, free: Callable[[Path], int] = free_space
    ) -> None:
        """Check the free space every LOOK_S until cancelled; return at once if the reserve is 0."""
        while self._least_bytes:
            try:
                free_bytes = await asyncio.to_thread(free, folder)
            except OSError as error:
                self._unknown = f"the free space of {folder} is not known: {error.strerror}"
            else:
                self._unknown = ""
                self.look(free_bytes, _sizes(recorder))
            await asyncio.sleep(LOOK_S)

    def look(self, free_bytes: int, sizes: Mapping[str, int]) -> None:
        """If `free_bytes` is low, stop the topic that grew most; if high, record all topics."""
        self._free_bytes = free_bytes
        grown = {topic: size - self._sizes.get(topic, 0) for topic, size in sizes.items()}
        self._sizes = sizes
        if free_bytes >= REOPEN * self._least_bytes:
            self._reopen()
        elif free_bytes < self._least_bytes * (1.0 - STEP * len(self.stopped)):
            open_topics = [each for each in self._gates if each not in self.stopped]
            heaviest = max(open_topics, key=lambda each: grown.get(each, 0), default="")
            if grown.get(heaviest, 0) > 0:
                self._stop(heaviest)

    def warnings(self) -> Iterator[str]:
        """Yield a sentence that says which topics are not recorded, and why."""
        if self._unknown:
            yield self._unknown
        for topic in islice(self.stopped, MAX_NAMED):
            yield self._sentence(topic)
        if len(self.stopped) > MAX_NAMED:
            yield f"{len(self.stopped) - MAX_NAMED} more topics are not recorded for that reason"

    def _stop(self, topic: str) -> None:
        self.stopped.append(topic)
        for gate in self._gates[topic]:
            gate.is_shut = True
        _log.warning("%s", self._sentence(topic))

    def _reopen(self) -> None:
        for topic in self.stopped:
            for gate in self._gates[topic]:
                gate.is_shut = False
            _log.info("%s is recorded again", topic)
        self.stopped.clear()

    def _sentence(self, topic: str) -> str:
        free, least = self._free_bytes / 1e9, self._least_bytes / 1e9
        return (
            f"{topic} is not recorded: the disk has {free:.2f} GB free, less than {least:g} GB "
            "(recording.min_free_gb; see robotctl recordings rm)"
        )


def _sizes(recorder: Recorder) -> dict[str, int]:
    sizes: dict[str, int] = {}
    for topic in recorder.stats().topics:
        sizes[topic.name] = sizes.get(topic.name, 0) + topic.bytes
    return sizes
