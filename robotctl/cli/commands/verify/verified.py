"""The result of `verify`, for this command and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robotctl.cli.terminal.progress import progress_bar
from robotctl.errors import UnreadableFile

if TYPE_CHECKING:
    from robotctl.recording.read.known_heads import KnownHeads
    from robotctl.recording.read.verified import VerifiedRecording


@dataclass(frozen=True, slots=True)
class VerifiedTogether:
    """Recordings that were verified together: the object of each in `--json`, and that of all."""

    recordings: list[dict[str, Any]]
    summary: dict[str, Any]


def verify_together(paths: Sequence[Path], head: str = "", *, quiet: bool) -> VerifiedTogether:
    """Verify recordings, the chain over all of them, and what this machine knows of their files.

    `head` must be in one of them, if it is given.
    """
    from robotctl.cli.commands.verify.report import summary_object
    from robotctl.recording.read.known_heads import KnownHeads

    heads = KnownHeads()
    found: list[VerifiedRecording] = []
    reports = []
    for path in paths:
        with progress_bar(f"reading {path.name}", quiet=quiet) as on_progress:
            reports.append(_verify(path, on_progress, heads, found))
    return VerifiedTogether(reports, summary_object(found, head, heads))


def verified(path: Path, on_progress: Callable[[int, int], None]) -> dict[str, Any]:
    """Return the result for one recording, as its object in `--json`."""
    from robotctl.recording.read.known_heads import KnownHeads

    return _verify(path, on_progress, KnownHeads(), [])


def _verify(
    path: Path,
    on_progress: Callable[[int, int], None],
    heads: KnownHeads,
    found: list[VerifiedRecording],
) -> dict[str, Any]:
    """Return the object of one recording; add it to `found` if it can be read."""
    from robotctl.cli.commands.verify.report import recording_object, unreadable_object
    from robotctl.recording.read.verified import verify_recording

    try:
        found.append(verify_recording(path, on_progress))
    except UnreadableFile as error:
        return unreadable_object(path, str(error))
    return recording_object(found[-1], heads)
