"""Looks at the health of the recorded topics, five times a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator

from robotctl.daemon.recording.topic_health import TopicHealth
from robotctl.daemon.recording.topic_watch import LOOK_S


class HealthLooks:
    """Gives the clocks to a TopicHealth."""

    def __init__(self, health: TopicHealth) -> None:
        self._health = health
        self.on_news: Callable[[], None] = lambda: None
        """Called when a topic has another trouble than before."""

        self.on_troubles: Callable[[str], None] | None = None
        """Called with what is not as expected when that has changed; "" if nothing is."""

        self._troubles = ""

    async def run(self) -> None:
        """Look until cancelled."""
        while True:
            if self.on_troubles is not None:
                troubles = self._health.troubles()
                if troubles != self._troubles:
                    self._troubles = troubles
                    self.on_troubles(troubles)
            await asyncio.sleep(LOOK_S)
            if self._health.look(time.monotonic(), time.time_ns()):
                self.on_news()

    def warnings(self) -> Iterator[str]:
        """Yield what is wrong now, and what was recently."""
        yield from self._health.warnings(time.monotonic())
