"""The messages about a replay: notes, progress, and a summary that repeats the notes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from robotctl.kernel.units import NS_PER_S
from robotctl.replay.plan import Route
from robotctl.replay.player import Lateness, Player
from robotctl.replay.replay_guard import withheld_note
from robotctl.replay.timeline import ReadAhead

Emit = Callable[[dict[str, Any]], None]
"""Sends a message: {"note"}, {"waiting"}, {"start"}, {"progress"} or {"summary"}."""


class ReplayReport:
    """Sends each note; collects the notes, skipped topics, withheld topics and missing data."""

    def __init__(self, emit: Emit) -> None:
        self.notes: list[str] = []
        self.skipped: dict[str, str] = {}
        self.withheld: dict[str, int] = {}
        """Number of withheld messages by topic."""

        self.missing: list[str] = []
        """Sentences about parts of the file that cannot be read."""

        self._emit = emit

    def note(self, text: str) -> None:
        """Send `text` as a note, and keep it for the summary; do nothing if `text` is ""."""
        if text:
            self.notes.append(text)
            self._emit({"note": text})

    def skip(self, topic: str, reason: str) -> None:
        """Report that a topic is not played; `reason` follows the word "it": "has no type"."""
        self.skipped[topic] = reason
        self.note(f"{topic} is skipped: it {reason}")

    def withhold(self, route: Route) -> None:
        """Report that no message of a route is sent, for safety."""
        self.withheld[route.topic.name] = route.topic.message_count
        self.note(withheld_note(route))

    def miss(self, sentences: Iterable[str]) -> None:
        """Report parts of the file that cannot be read; repeated sentences are ignored."""
        for sentence in sentences:
            if sentence not in self.missing:
                self.missing.append(sentence)
                self.note(f"missing: {sentence}")


BEHIND_S = 0.05
"""A shorter delay [s] does not count as behind: nobody sees it, and the player may catch up."""


def progress(player: Player, ahead: ReadAhead, now_ns: int) -> dict[str, Any]:
    """Return the progress of a replay; `behind` counts messages overdue by BEHIND_S."""
    schedule, position_ns = player.control.schedule, player.position_ns
    behind = 0
    if schedule.rate is not None:
        overdue_ns = round(BEHIND_S * NS_PER_S * schedule.rate)
        due_ns = schedule.position_ns(now_ns)
        if due_ns - position_ns > overdue_ns:
            behind = ahead.count(position_ns, due_ns - overdue_ns)
        position_ns = max(position_ns, due_ns) if not behind else position_ns
    return {
        "position_s": position_ns / NS_PER_S,
        "sent": player.sent,
        "behind": behind,
        "rate": schedule.rate,
        "paused": schedule.paused,
    }


def summary(
    report: ReplayReport, player: Player, routes: Iterable[Route], *, interrupted: bool
) -> dict[str, Any]:
    """Return the summary of a replay."""
    topics = player.topics
    return {
        "sent": player.sent,
        "failed": sum(topic.failed for topic in topics.values()),
        "topics": [
            {
                "name": route.topic.name,
                "published": route.name,
                "type": route.topic.type_name,
                "requests": route.requests,
                "sent": topics[route.topic.name].sent,
                "failed": topics[route.topic.name].failed,
            }
            for route in routes
        ],
        "withheld": report.withheld,
        "skipped": report.skipped,
        "timing_error_us": _timing(player.lateness),
        "played_s": player.position_ns / NS_PER_S,
        "interrupted": interrupted,
        "missing": report.missing,
        "notes": report.notes,
    }


def _timing(lateness: Lateness) -> dict[str, float] | None:
    if not lateness.count:
        return None
    return {
        "p50": lateness.quantile_us(0.5),
        "p99": lateness.quantile_us(0.99),
        "max": lateness.max_ns / 1e3,
    }
