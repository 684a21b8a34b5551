"""The topics of the robot whose journal is checked, by the parameters in the metadata."""

from __future__ import annotations

from robotctl.recording import RecordingInfo
from robotctl.recording.format.journal import TOPIC
from robotctl.recording.format.metadata_names import INFO_RECORD


def full_name(info: RecordingInfo, journal_topic: str, parameter: str, default: str) -> str:
    """Return the full name of the topic that a parameter names, in the journal's namespace."""
    name = info.metadata.get(INFO_RECORD, {}).get(f"parameter.{parameter}", default)
    if name.startswith("/"):
        return name
    return f"{journal_topic.removesuffix(f'/{TOPIC}')}/{name}"
