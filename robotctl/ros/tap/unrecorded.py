"""What the tap does not record, in sentences for status and log, of bounded number."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from itertools import islice

_log = logging.getLogger(__name__)

MAX_WARNINGS = 50
"""Topics that are named as not recorded; of more than that, the number is told."""

MAX_SAID = 1_000
"""Such sentences that the log gets: a neighbour may invent new topics forever."""


class Unrecorded:
    """Each sentence goes to the log once."""

    def __init__(self) -> None:
        self.problems: dict[str, str] = {}
        """Topic of the graph -> a sentence on what of it is not recorded."""

        self._said: set[str] = set()
        self._missed = 0
        self._last_missed = ""

    def note(self, topic: str, sentence: str) -> None:
        """Name what of a topic is not recorded, until it is cleared or gone."""
        self.problems[topic] = sentence
        self._say(sentence)

    def clear(self, topics: Iterable[str]) -> None:
        """Forget what was noted of topics that are recorded, or gone."""
        for topic in topics:
            self.problems.pop(topic, None)

    def miss(self, topic: str, type_name: str) -> None:
        """Count a topic that went before its type was loaded."""
        self._missed += 1
        self._last_missed = f"{topic} ({type_name}) came and went before it could be recorded"
        self._say(self._last_missed)

    def warnings(self) -> Iterator[str]:
        """Say what is not recorded, and why: a sentence for each topic, up to MAX_WARNINGS."""
        yield from islice(self.problems.values(), MAX_WARNINGS)
        more = len(self.problems) - MAX_WARNINGS
        if more > 0:
            yield f"{more} more topics are not recorded, or not whole"
        if self._missed:
            others = f" (and {self._missed - 1} other topics)" if self._missed > 1 else ""
            yield f"{self._last_missed}{others}"

    def _say(self, sentence: str) -> None:
        if sentence not in self._said and len(self._said) < MAX_SAID:
            self._said.add(sentence)
            _log.warning("%s", sentence)
