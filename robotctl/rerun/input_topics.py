"""The topics of the inputs, by the parameters in the metadata."""

from __future__ import annotations

from typing import NamedTuple

from robotctl.recording import RecordingInfo
from robotctl.rerun.own_topics import full_name
from robotctl.rerun.recorded_filter import RecordedFilter


class InputTopic(NamedTuple):
    """A topic: its full name, None if it is not recorded, and its recorded type.

    `is_left_out` tells whether the configuration leaves it out.
    """

    name: str | None = None
    type_name: str = ""
    is_left_out: bool = False


class InputTopics:
    """The topics of the robot with this journal."""

    def __init__(self, info: RecordingInfo, journal_topic: str) -> None:
        self._info = info
        self._journal_topic = journal_topic
        self._filter = RecordedFilter(info, journal_topic)

    def of(self, parameter: str, default: str, *types: str) -> InputTopic:
        """Return the topic that a parameter names, which has one of these types."""
        name = full_name(self._info, self._journal_topic, parameter, default)
        for topic in self._info.topics:
            if topic.name == name and topic.type_name in types:
                return InputTopic(name, topic.type_name)
        return InputTopic(is_left_out=self._filter.leaves_out(name, *types))
