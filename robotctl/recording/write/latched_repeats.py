"""The latched messages that a file repeats from the one before, so that it stands alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from robotctl.recording.format.records import PlainMessage
from robotctl.recording.write.channel_state import ChannelState

MAX_SHARE: Final = 0.25
"""Maximum share of a file that repeats may take. Otherwise each new file could be full at once."""


def repeats(
    channels: Sequence[ChannelState], newest_ns: int, split_bytes: int
) -> list[PlainMessage]:
    """Return the last latched message of each publisher, as if it came just now.

    `newest_ns` is the log time that they get; 0 keeps their own. If not all fit, the smallest are
    chosen, and the others are counted in `not_repeated` of their channel.
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
            state = channels[latched[position][0]]
            state.not_repeated += 1
            state.mark()
    return [message for message, fit in zip(latched, fits, strict=True) if fit]
