"""Which topics are recorded: names and types, as patterns."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import translate

TYPE_PREFIX = "type:"
"""Before a pattern that a topic's type has to match, not its name."""


class TopicFilter:
    """Records a topic that `include` names, or any where it is empty, unless `exclude` names it.

    A pattern is a name (`/cmd_vel`), a name with the wildcards `*`, `?` and `[...]`, of which `*`
    also matches `/` (`/camera/*`), or either for the type (`type:sensor_msgs/msg/Image`). The
    topics in `always` are recorded whatever the patterns say.
    """

    def __init__(
        self,
        include: Iterable[str] = (),
        exclude: Iterable[str] = (),
        always: Iterable[str] = (),
    ) -> None:
        self._include = [_Pattern(text) for text in include]
        self._exclude = [_Pattern(text) for text in exclude]
        self._always = frozenset(always)

    def records(self, topic: str, type_name: str) -> bool:
        """Say whether the topic is recorded."""
        if topic in self._always:
            return True
        if any(pattern.matches(topic, type_name) for pattern in self._exclude):
            return False
        included = (pattern.matches(topic, type_name) for pattern in self._include)
        return not self._include or any(included)

    def can_leave_out(self, topic: str) -> bool:
        """Say whether a pattern could keep the topic from being recorded."""
        return topic not in self._always


class _Pattern:
    def __init__(self, text: str) -> None:
        self._of_type = text.startswith(TYPE_PREFIX)
        self._match = re.compile(translate(text.removeprefix(TYPE_PREFIX))).match

    def matches(self, topic: str, type_name: str) -> bool:
        return self._match(type_name if self._of_type else topic) is not None
