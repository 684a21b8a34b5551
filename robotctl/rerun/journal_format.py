"""Tells a journal of another version from one of this version that was changed, by its fields."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from robotctl.kernel.codec import to_json
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.journal_values import read_snapshot


def other_field(entry: JournalEntry) -> str:
    """Return how the fields of a snapshot differ from those of this version, "" if they do not.

    Raises:
        UnreadableFile: The entry is not a snapshot of this version.
    """
    ours = json.loads(to_json(read_snapshot(entry)))
    return next(_differing("", json.loads(entry.data), ours), "")


def _differing(path: str, theirs: Any, ours: Any) -> Iterator[str]:
    if isinstance(theirs, dict) and isinstance(ours, dict):
        for name in ours:
            if name not in theirs:
                yield f"lacks {path}{name}"
        for name, value in theirs.items():
            if name not in ours:
                yield f"has {path}{name[:40]}"
            else:
                yield from _differing(f"{path}{name}.", value, ours[name])
    elif isinstance(theirs, list) and isinstance(ours, list):
        for each, own in zip(theirs, ours, strict=False):
            yield from _differing(path, each, own)
