"""The result of `verify` for one recording, for other commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from robotctl.errors import UnreadableFile


def verified(path: Path, on_progress: Callable[[int, int], None]) -> dict[str, Any]:
    """Return the result for one recording, as its object in `--json`."""
    from robotctl.cli.commands.verify.report import recording_object, unreadable_object
    from robotctl.recording.read.verified import verify_recording

    try:
        return recording_object(verify_recording(path, on_progress))
    except UnreadableFile as error:
        return unreadable_object(path, str(error))
