"""The progress and summary messages of a replay."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from robotctl.kernel.units import NS_PER_S
from robotctl.replay.lateness import Lateness
from robotctl.replay.plan import Route
from robotctl.replay.player import Player
from robotctl.replay.read_ahead import ReadAhead
from robotctl.replay.replay_report import ReplayReport

BEHIND_S = 0.05
"""A shorter delay is not visible, and the next message may still be on time."""


def progress(player: Player, ahead: ReadAhead, now_ns: int) -> dict[str, Any]:
    """Return where a replay is; `behind` counts messages that are overdue."""
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
