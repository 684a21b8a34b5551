"""Feeds the server from a recording, at the pace and from the moment that viewers ask for."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Final

from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Message, Recording
from robotctl.recording.read.file_index import note_missing
from robotctl.replay.job import MAX_RATE, MIN_RATE
from robotctl.replay.schedule import Schedule
from robotctl.view.foxglove_messages import (
    PlaybackStatus,
    StatusLevel,
    playback_state,
)
from robotctl.view.foxglove_requests import PlaybackRequest
from robotctl.view.view_server import ViewServer

CAPABILITIES: Final = ("playbackControl", "time")

BATCH_MESSAGES: Final = 500
BATCH_BYTES: Final = 4 << 20
"""How much is read at once, in a thread."""

PERIOD_S: Final = 0.02
"""How long due messages are collected, and how often viewers are told the time."""

MAX_LOG_NS: Final = (1 << 64) - 1
"""The last time that a file and the protocol can tell."""

_SCHEMAS: Final = ("ros2msg", "ros2idl")


class RecordedView:
    """Plays while there is a viewer; all viewers share one position."""

    def __init__(
        self, recording: Recording, server: ViewServer, span_ns: tuple[int, int], at_ns: int = 0
    ) -> None:
        """Offer the topics of a recording; `span_ns` is its first and last time.

        It begins at `at_ns` [since the epoch], or where that is not in the span, at its nearer end.
        """
        self._recording = recording
        self._server = server
        self._start_ns, self._end_ns = span_ns
        self._schedule = Schedule(time.monotonic_ns(), self._within(at_ns), 1.0, paused=True)
        self._plays = True
        """Whether viewers want it to play; it does while there is one."""

        self._viewers = 0
        self._missing: list[str] = []
        """Sentences about what cannot be shown, bounded in number."""

        self._shown = 0
        """How many of them the viewers have been told."""

        self._names: dict[int, str] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._watched: dict[int, str] = {}
        """The channels that are watched, with their topics."""

        self._unread: Iterator[Message] = iter(())
        self._read: deque[Message] = deque()
        self._is_read = False
        """Whether everything from the position to the end has been read."""

        self._unsent_ns = self._schedule.at_ns
        """What is watched and has an earlier log time has been sent."""

        self._reread = False
        """Whether the position or the watched topics have changed since the last read."""

        self._changed = asyncio.Event()
        server.on_subscribed = self._subscribed
        server.on_unwatched = self._unwatched
        server.on_viewers = self._viewers_changed
        server.on_playback = self._control
        self._offer()

    async def run(self) -> None:
        """Play until cancelled."""
        while True:
            self._changed.clear()
            if self._reread:
                await self._look_back()
            elif not self._schedule.paused:
                await self._play()
            if not self._changed.is_set():
                await self._pause()

    # From the server

    def _viewers_changed(self, count: int) -> None:
        self._viewers = count
        self._follow()
        self._tell(did_seek=False)

    def _subscribed(self, channel_id: int) -> None:
        self._watched[channel_id] = self._names[channel_id]
        self._restart()

    def _unwatched(self, channel_id: int) -> None:
        del self._watched[channel_id]
        self._restart()

    def _control(self, request: PlaybackRequest) -> None:
        """Do what a viewer asks for; playing on from the end begins at the beginning."""
        now_ns = time.monotonic_ns()
        seek_ns = request.seek_ns
        if seek_ns is None and request.play and self._status() is PlaybackStatus.ENDED:
            seek_ns = self._start_ns
        if seek_ns is not None:
            at_ns = self._within(seek_ns)
            self._schedule = replace(self._schedule, moment_ns=now_ns, at_ns=at_ns)
            self._unsent_ns = at_ns
            self._restart()
        rate = min(max(request.rate, MIN_RATE), MAX_RATE)
        self._schedule = self._schedule.with_rate(now_ns, rate)
        self._plays = request.play
        self._follow()
        self._tell(did_seek=seek_ns is not None, request_id=request.request_id)

    # The playback

    def _within(self, at_ns: int) -> int:
        return min(max(at_ns, self._start_ns), self._end_ns)

    def _offer(self) -> None:
        for key, (channel, schema) in self._recording.channels().items():
            topic, type_name = key
            if channel.message_encoding != "cdr" or schema is None or not schema.data:
                self._miss(f"{topic} is not shown: its type is not in the recording")
            elif schema.encoding not in _SCHEMAS:
                self._miss(f"{topic} is not shown: its type is given as {schema.encoding[:20]!r}")
            else:
                text = schema.data.decode(errors="replace")
                channel_id = self._server.offer(topic, type_name, text, schema.encoding)
                self._channels[key] = channel_id
                self._names[channel_id] = topic
        for sentence in self._recording.missing:
            self._miss(sentence)
        self._show_missing()

    def _follow(self) -> None:
        """Play or pause as viewers want."""
        now_ns = time.monotonic_ns()
        at_end = self._schedule.position_ns(now_ns) >= self._end_ns
        plays = self._plays and self._viewers > 0 and not at_end
        if plays == self._schedule.paused:
            self._schedule = (self._schedule.resume if plays else self._schedule.pause)(now_ns)
        self._changed.set()

    def _restart(self) -> None:
        self._reread = True
        self._changed.set()

    async def _look_back(self) -> None:
        """Send the last message of each watched topic before what is unsent, and read on there."""
        self._reread = self._is_read = False
        at_ns = self._unsent_ns
        self._read.clear()
        self._unread = iter(())
        topics = set(self._watched.values())
        wanted = dict.fromkeys(topics, 1)
        before = await asyncio.to_thread(self._recording.last_before, at_ns, wanted, self._miss)
        if self._reread:
            return
        for message in before:
            self._publish(message)
        window = (at_ns, self._end_ns)
        if topics:
            self._unread = self._recording.messages(topics, self._miss, window)
        self._server.tell_time(self._position_ns())
        self._show_missing()
        self._changed.set()

    async def _play(self) -> None:
        """Send what is due."""
        if not (self._read or self._is_read):
            batch = await asyncio.to_thread(_next_batch, self._unread)
            if self._reread:
                return
            self._read.extend(batch)
            self._is_read = not batch
            self._show_missing()
        at_ns = self._position_ns()
        while self._read and self._read[0].log_ns <= at_ns:
            self._unsent_ns = self._read[0].log_ns
            self._publish(self._read.popleft())
        if self._read or self._is_read:
            self._unsent_ns = at_ns + 1
        self._server.tell_time(at_ns)
        if not (self._read or self._is_read):
            self._changed.set()  # more may be due
        elif at_ns >= self._end_ns:
            self._follow()
            self._tell(did_seek=False)

    async def _pause(self) -> None:
        """Wait for a change; while it plays, no longer than until more is due."""
        wait_s = None if self._schedule.paused else PERIOD_S
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await self._changed.wait()

    def _publish(self, message: Message) -> None:
        channel_id = self._channels.get((message.topic, message.type_name))
        if channel_id is not None:
            self._server.publish(channel_id, message.log_ns, message.data)

    def _position_ns(self) -> int:
        return min(self._schedule.position_ns(time.monotonic_ns()), self._end_ns)

    def _status(self) -> PlaybackStatus:
        if self._position_ns() >= self._end_ns:
            return PlaybackStatus.ENDED
        return PlaybackStatus.PAUSED if self._schedule.paused else PlaybackStatus.PLAYING

    def _tell(self, *, did_seek: bool, request_id: str = "") -> None:
        at_ns, rate = self._position_ns(), self._schedule.rate or 1.0
        self._server.tell_playback(
            playback_state(self._status(), at_ns, rate, did_seek=did_seek, request_id=request_id)
        )

    def _miss(self, sentence: str) -> None:
        """Note what cannot be shown; a part that is read again after a seek is the same loss."""
        if sentence not in self._missing:
            note_missing(self._missing, sentence)

    def _show_missing(self) -> None:
        for sentence in self._missing[self._shown :]:
            self._server.note(sentence, StatusLevel.WARNING, sentence)
        self._shown = len(self._missing)


def _next_batch(messages: Iterator[Message]) -> list[Message]:
    """Read the next messages; none at the end."""
    batch: list[Message] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message.data)
        if len(batch) >= BATCH_MESSAGES or size >= BATCH_BYTES:
            break
    return batch


def span_of_recording(recording: Recording) -> tuple[int, int]:
    """Return the first and last time [ns], and at least a second, which ends by MAX_LOG_NS."""
    info = recording.info()
    start_ns = min(info.start_ns, MAX_LOG_NS - NS_PER_S)
    return start_ns, max(info.end_ns, start_ns + NS_PER_S)
