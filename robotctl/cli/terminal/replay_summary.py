"""The summary of a replay, as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from robotctl.cli.terminal.text import printable


def summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the summary of a replay, from its object in `--json`."""
    domain, names = summary["domain_id"], summary["prefix"]
    where = f"with the prefix {names}" if names else "under the original names"
    yield f"  sent        {summary['sent']} messages in ROS domain {domain}, {where}"
    if summary["failed"]:
        yield f"  not sent    {summary['failed']} messages, refused by the middleware"
    for topic, count in summary["withheld"].items():
        yield f"  withheld    {printable(topic)}, {count} messages"
    for topic, reason in summary["skipped"].items():
        yield f"  skipped     {printable(topic)}: {printable(reason)}"
    timing = summary["timing_error_us"]
    if timing is not None:
        p50, p99, worst = (_microseconds(timing[key]) for key in ("p50", "p99", "max"))
        yield f"  timing      {p50} late p50, {p99} p99, {worst} at most"


def _microseconds(value: float) -> str:
    return f"{value:.0f} us" if value < 10_000 else f"{value / 1000:.0f} ms"
