"""Tells which topics the configuration of a recording leaves out of it."""

from __future__ import annotations

import ast
from typing import Final

from robotctl.recording import RecordingInfo
from robotctl.recording.format.metadata_names import INFO_RECORD
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.rerun.own_topics import full_name

MAX_TEXT: Final = 100_000
"""The longest list of patterns that is read."""


class RecordedFilter:
    """The patterns in the metadata of a recording, for the robot with this journal."""

    def __init__(self, info: RecordingInfo, journal_topic: str) -> None:
        # The others that are always recorded are compared with the journal in any case.
        always = [full_name(info, journal_topic, "odometry.topic", "odom")]
        self._filter = TopicFilter(_patterns(info, "include"), _patterns(info, "exclude"), always)

    def leaves_out(self, topic: str, *types: str) -> bool:
        """Return whether a topic that has one of these types is not recorded."""
        return not all(self._filter.records(topic, each) for each in types)


def _patterns(info: RecordingInfo, key: str) -> list[str]:
    """Return the patterns as the metadata names them; none where it is no list of texts."""
    text = info.metadata.get(INFO_RECORD, {}).get(f"parameter.recording.{key}", "[]")
    try:
        values = ast.literal_eval(text[:MAX_TEXT])
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return []
    is_list = isinstance(values, list) and all(isinstance(each, str) for each in values)
    return values if is_list else []
