"""Notes about a replay: sent at once, and again in the summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from robotctl.replay.plan import Route
from robotctl.replay.replay_guard import withheld_note

Emit = Callable[[dict[str, Any]], None]
"""Sends a message: {"note"}, {"waiting"}, {"start"}, {"progress"} or {"summary"}."""


class ReplayReport:
    """Notes in their order; topics that were skipped or withheld, and missing data."""

    def __init__(self, emit: Emit) -> None:
        self.notes: list[str] = []
        self.skipped: dict[str, str] = {}
        self.withheld: dict[str, int] = {}
        """Number of withheld messages by topic."""

        self.missing: list[str] = []
        """What cannot be read of the file, in sentences."""

        self._emit = emit

    def note(self, text: str) -> None:
        """Send a sentence; "" is ignored."""
        if text:
            self.notes.append(text)
            self._emit({"note": text})

    def skip(self, topic: str, reason: str) -> None:
        """Report that a topic is not played; `reason` continues the sentence "it ..."."""
        self.skipped[topic] = reason
        self.note(f"{topic} is skipped: it {reason}")

    def withhold(self, route: Route) -> None:
        """Report that a route is withheld with all its messages."""
        self.withheld[route.topic.name] = route.topic.message_count
        self.note(withheld_note(route))

    def miss(self, sentences: Iterable[str]) -> None:
        """Report parts of the file that cannot be read; repeated sentences are ignored."""
        for sentence in sentences:
            if sentence not in self.missing:
                self.missing.append(sentence)
                self.note(f"missing: {sentence}")
