"""Read, write, recover and clip MCAP recordings. No ROS needed.

A library user may rely on the names in `__all__`; the modules below may change.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.recording.arrays import TopicArrays, read_arrays
    from robotctl.recording.format.journal import EntryKind, JournalEntry
    from robotctl.recording.format.names import Compression, EventKind
    from robotctl.recording.format.recorded_events import RecordedEvent
    from robotctl.recording.format.topics import Topic, TopicStats
    from robotctl.recording.keep.clip import Clip, Moment, cut_clip
    from robotctl.recording.keep.listing import ListedRecording, list_recordings
    from robotctl.recording.keep.recover import RecoveryReport, recover, recover_folder
    from robotctl.recording.read.journal_reader import RecordedEntry, read_journal
    from robotctl.recording.read.messages import Message
    from robotctl.recording.read.reader import (
        Recording,
        RecordingInfo,
        TopicInfo,
        read_info,
        read_messages,
    )
    from robotctl.recording.write.recorder import Recorder, RecorderState, RecorderStats
    from robotctl.recording.write.recorder_options import RecorderOptions

__all__ = [
    "Clip",
    "Compression",
    "EntryKind",
    "EventKind",
    "JournalEntry",
    "ListedRecording",
    "Message",
    "Moment",
    "RecordedEntry",
    "RecordedEvent",
    "Recorder",
    "RecorderOptions",
    "RecorderState",
    "RecorderStats",
    "Recording",
    "RecordingInfo",
    "RecoveryReport",
    "Topic",
    "TopicArrays",
    "TopicInfo",
    "TopicStats",
    "cut_clip",
    "list_recordings",
    "read_arrays",
    "read_info",
    "read_journal",
    "read_messages",
    "recover",
    "recover_folder",
]

_NAMES_OF_MODULE = {
    "arrays": ("TopicArrays", "read_arrays"),
    "format.journal": ("EntryKind", "JournalEntry"),
    "format.names": ("Compression", "EventKind"),
    "format.recorded_events": ("RecordedEvent",),
    "format.topics": ("Topic", "TopicStats"),
    "keep.clip": ("Clip", "Moment", "cut_clip"),
    "keep.listing": ("ListedRecording", "list_recordings"),
    "keep.recover": ("RecoveryReport", "recover", "recover_folder"),
    "read.journal_reader": ("RecordedEntry", "read_journal"),
    "read.messages": ("Message",),
    "read.reader": ("Recording", "RecordingInfo", "TopicInfo", "read_info", "read_messages"),
    "write.recorder": ("Recorder", "RecorderState", "RecorderStats"),
    "write.recorder_options": ("RecorderOptions",),
}
_MODULES = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
