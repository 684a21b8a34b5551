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


def own_name(info: RecordingInfo, journal_topic: str, key: str) -> tuple[str, bool]:
    """Return the full name of a topic or service, and whether the metadata tells it by `key`.

    A recording that does not tell it has no other name for it than the last part of the key.
    """
    told = info.metadata.get(INFO_RECORD, {}).get(key)
    namespace = journal_topic.removesuffix(f"/{TOPIC}")
    return told or f"{namespace}/{key.rpartition('.')[2]}", told is not None
