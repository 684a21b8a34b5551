"""Which topics are recorded: patterns for names and types."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import translate

TYPE_PREFIX = "type:"
"""Prefix of a pattern that is matched against the type instead of the name."""


def is_plain_name(pattern: str) -> bool:
    """Return whether a pattern is the name of one topic."""
    return pattern.startswith("/") and not set(pattern) & set("*?[")


class TopicFilter:
    """A filter that accepts a topic if `include` matches it or is empty, and `exclude` does not
    match.

    A pattern is a name (`/cmd_vel`), a name with the wildcards `*`, `?` and `[...]` (`*` also
    matches `/`: `/camera/*`), or one of these for the type (`type:sensor_msgs/msg/Image`). The
    topics in `always` are recorded regardless of the patterns.
    """

    def __init__(
        self,
        include: Iterable[str] = (),
        exclude: Iterable[str] = (),
        always: Iterable[str] = (),
    ) -> None:
        self._include = [TopicPattern(text) for text in include]
        self._exclude = [TopicPattern(text) for text in exclude]
        self._always = frozenset(always)

    def records(self, topic: str, type_name: str) -> bool:
        """Return whether the topic is recorded."""
        if topic in self._always:
            return True
        if any(pattern.matches(topic, type_name) for pattern in self._exclude):
            return False
        included = (pattern.matches(topic, type_name) for pattern in self._include)
        return not self._include or any(included)

    def can_leave_out(self, topic: str) -> bool:
        """Return whether patterns may exclude the topic. Some topics are always recorded."""
        return topic not in self._always


class TopicPattern:
    """A pattern as `TopicFilter` describes it."""

    def __init__(self, text: str) -> None:
        self._of_type = text.startswith(TYPE_PREFIX)
        self._match = re.compile(translate(text.removeprefix(TYPE_PREFIX))).match

    def matches(self, topic: str, type_name: str) -> bool:
        """Return whether the pattern matches the topic's name, or its type."""
        return self._match(type_name if self._of_type else topic) is not None
