"""Rates that a configuration gives to topics by patterns."""

from __future__ import annotations

from collections.abc import Iterable

from robotctl.recording.write.topic_filter import TopicPattern


class RateByTopic:
    """Rates [1/s] from texts such as `/camera/*=5`; the first pattern that matches counts."""

    def __init__(self, texts: Iterable[str]) -> None:
        parts = (text.rpartition("=") for text in texts)
        self._rates = [(TopicPattern(pattern), float(rate)) for pattern, _, rate in parts]

    def of(self, topic: str, type_name: str) -> float | None:
        """Return the rate of a topic, None if no pattern matches it."""
        matching = (rate for pattern, rate in self._rates if pattern.matches(topic, type_name))
        return next(matching, None)
