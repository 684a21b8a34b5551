"""The latched messages that a file repeats from the one before, so that it stands alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from robotctl.recording.format.records import PlainMessage
from robotctl.recording.write.channel_state import ChannelState

MAX_SHARE: Final = 0.25
"""Of a file's size that repeats may take: else it is full at once, and so is the next one."""


def repeats(
    channels: Sequence[ChannelState], newest_ns: int, split_bytes: int
) -> list[PlainMessage]:
    """The last latched message of each publisher, as if it came just now, as many as fit.

    `newest_ns` is the log time that they get, 0 for their own. The smallest go first; those that
    do not fit are counted by their topic as `not_repeated`.
    """
    latched = [
        (
            channel,
            message.data,
            newest_ns or message.log_ns,
            message.publish_ns,
            message.sequence,
        )
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
