"""Judges the last messages of an input, after all that the control loop received.

Some were under way when the recording ended. The control loop receives inputs with best effort, so
earlier ones may be lost. Then other messages of this input are lost, too.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, NamedTuple

from robotctl.kernel.units import NS_PER_S

AFTER_NS: Final = 2 * NS_PER_S
"""How long after the last journal entry a message may be recorded."""

FEW: Final = 10
"""The number of messages that may always be under way..."""

BURST: Final = 10.0
"""...plus this factor times the number expected at the mean rate of their publisher."""

LOST: Final = 2
"""The number of messages in a row that may be lost if no others are lost."""


class UnheardEnd(NamedTuple):
    """The messages with these log times after the last one that became an input.

    The journal ends at `end_ns`; all times are since the epoch. Messages may be under way for
    `window_ns`, and come at `rate_hz`. Up to `lost` of them may have been lost before.
    """

    log_ns: Collection[int]
    end_ns: int
    window_ns: int
    rate_hz: float
    lost: float

    @property
    def earlier(self) -> int:
        """The number of messages that came too early to be under way at the end."""
        return sum(each < self.end_ns - self.window_ns for each in self.log_ns)

    def difference(self) -> str:
        """Return what is wrong about the messages, "" if nothing is."""
        after = sum(each > self.end_ns + AFTER_NS for each in self.log_ns)
        if after:
            return f"{after} messages are recorded after the end of the journal"
        under_way = len(self.log_ns) - self.earlier
        most = FEW + BURST * self.rate_hz * self.window_ns / NS_PER_S
        if under_way > most or self.earlier > self.lost:
            return f"the last {len(self.log_ns)} messages never became an input"
        return ""
