"""What the tap does not record: a limited number of sentences for status and log."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from itertools import islice

_log = logging.getLogger(__name__)

MAX_WARNINGS = 50
"""Limit on the topics that `warnings` names; the others are counted."""

MAX_SAID = 1_000
"""Limit on the logged sentences: another process may create new topics without end."""


class Unrecorded:
    """Collects the sentences; each goes to the log once."""

    def __init__(self) -> None:
        self.problems: dict[str, str] = {}
        """Topic -> the sentence that says what of it is not recorded."""

        self._said: set[str] = set()
        self._missed = 0
        self._last_missed = ""

    def note(self, topic: str, sentence: str) -> None:
        """Set the sentence of a topic, until `clear`."""
        self.problems[topic] = sentence
        self._say(sentence)

    def clear(self, topics: Iterable[str]) -> None:
        """Forget the sentences of topics that are recorded now, or gone."""
        for topic in topics:
            self.problems.pop(topic, None)

    def miss(self, topic: str, type_name: str) -> None:
        """Count a topic that ended before its type was loaded."""
        self._missed += 1
        self._last_missed = f"{topic} ({type_name}) came and went before it could be recorded"
        self._say(self._last_missed)

    def warnings(self) -> Iterator[str]:
        """Yield a sentence for each topic that is not recorded, up to MAX_WARNINGS."""
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
