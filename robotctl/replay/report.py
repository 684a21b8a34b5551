"""What is noted while a replay is prepared and runs: said at once, and again in the summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from robotctl.replay.guard import withheld_note
from robotctl.replay.plan import Route

Tell = Callable[[dict[str, Any]], None]
"""Says something to the user: {"note"}, {"waiting"}, {"start"}, {"progress"} or {"summary"}."""


class ReplayReport:
    """Notes in their order; what is skipped, withheld and missing. Keys are recorded topics."""

    def __init__(self, tell: Tell) -> None:
        self.notes: list[str] = []
        self.skipped: dict[str, str] = {}
        self.withheld: dict[str, int] = {}
        """How many messages of a topic are held back."""

        self.missing: list[str] = []
        """What of the file cannot be read, in sentences."""

        self._tell = tell

    def note(self, text: str) -> None:
        """Say a sentence; "" says nothing."""
        if text:
            self.notes.append(text)
            self._tell({"note": text})

    def skip(self, topic: str, reason: str) -> None:
        """A topic is not played; the reason stands after its name."""
        self.skipped[topic] = reason
        self.note(f"{topic} is skipped: it {reason}")

    def withhold(self, route: Route) -> None:
        """A route is held back with all of its messages."""
        self.withheld[route.topic.name] = route.topic.message_count
        self.note(withheld_note(route))

    def miss(self, sentences: Iterable[str]) -> None:
        """Something of the file cannot be read; a loop that meets it again says it once."""
        for sentence in sentences:
            if sentence not in self.missing:
                self.missing.append(sentence)
                self.note(f"missing: {sentence}")
