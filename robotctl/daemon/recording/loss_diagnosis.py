"""The recorder's message counts as a diagnosis for /diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robotctl.recording import RecorderState, RecorderStats
from robotctl.recording.format.topics import COUNTERS, by_topic
from robotctl.ros.nodes.publishers import Diagnosis, DiagnosticLevel

MAX_TOPICS = 100
"""Limit of the topics that are listed, those with the most missing messages first."""


def diagnose(stats: RecorderStats, warnings: Sequence[str]) -> Diagnosis:
    """Return the recorder's part of /diagnostics: ERROR if recording has failed, WARN if the
    recording lacks messages, else OK."""
    if stats.state is not RecorderState.RECORDING:
        level, message = DiagnosticLevel.ERROR, stats.failure or stats.state.value
    elif stats.dropped or stats.lost:
        level, message = DiagnosticLevel.WARN, _lacking(stats.dropped, stats.lost)
    elif warnings:
        level, message = DiagnosticLevel.WARN, warnings[0]
    else:
        level, message = DiagnosticLevel.OK, "everything is recorded"
    return Diagnosis("recorder", level, message, dict(_values(stats)))


def _values(stats: RecorderStats) -> Iterator[tuple[str, str]]:
    yield "state", stats.state.value
    yield "file", str(stats.file)
    for name in ("bytes", *COUNTERS):
        yield name, str(getattr(stats, name))
    lacking = [topic for topic in by_topic(stats.topics) if topic.dropped or topic.lost]
    lacking.sort(key=lambda topic: (-topic.dropped - topic.lost, topic.name))
    yield from ((each.name, _lacking(each.dropped, each.lost)) for each in lacking[:MAX_TOPICS])


def _lacking(dropped: int, lost: int) -> str:
    return f"{dropped} messages dropped, {lost} lost on their way here"
