"""Opens the recording of a row at its moment: as a report or a clip."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from robotctl.base.errors import Refused, UsageError
from robotctl.kernel.units import NS_PER_S

AROUND_DRIVE_S: Final = (2.0, 2.0)
AROUND_EVENT_S: Final = (30.0, 5.0)
"""What a clip holds before and after."""

DISPLAYS: Final = ("DISPLAY", "WAYLAND_DISPLAY")


class OpenAs(StrEnum):
    """The command that shows a recording."""

    REPORT = "report"
    CLIP = "clip"


@dataclass(frozen=True, slots=True)
class ShownPage:
    """A recording, and a moment or a drive in it, in seconds after its beginning."""

    path: Path
    at_s: float | None
    drive_s: float | None
    """How long the drive lasts, None if the row is about something else."""


def shown_row(rows: list[dict[str, Any]], number: int, folder: Path) -> ShownPage:
    """Return what row `number`, from 1 on, is about.

    Raises:
        Refused: There is no such row, or its recording is gone.
        UsageError: The row names no recording.
    """
    if not 1 <= number <= len(rows):
        raise Refused(f"there is no row {number}: the answer has {len(rows) or 'none'}")
    row = rows[number - 1]
    if not isinstance(row.get("recording"), str):
        raise UsageError("--open needs the column recording", "add it to the query")
    path = folder / Path(row["recording"]).name
    if not path.exists():
        raise Refused(f"{path} does not exist any more")
    drive_s = (row.get("duration_s") or 0.0) if "drive" in row else None
    return ShownPage(path, _offset_s(path, row), drive_s)


def open_as(shown: ShownPage, kind: OpenAs, *, as_json: bool) -> None:
    """Do what the command of that name does with the recording, at the moment.

    Raises:
        UsageError: The row has no moment to clip.
        RobotctlError: As the command raises it.
    """
    file = str(shown.path)
    at = None if shown.at_s is None else f"{shown.at_s:.3f}"
    if kind is OpenAs.CLIP:
        from robotctl.cli.commands.recordings.clip import clip

        if at is None:
            raise UsageError("the row has no moment to clip", "ask for drives, or for --events")
        before_s, after_s = AROUND_EVENT_S if shown.drive_s is None else AROUND_DRIVE_S
        clip(file, at=at, before=before_s, after=after_s + (shown.drive_s or 0.0), as_json=as_json)
    else:
        from robotctl.cli.commands.recordings.report.command import report

        report(file, as_json=as_json)
        _show_page(shown)


def _show_page(shown: ShownPage) -> None:
    """Show the page at the moment in a browser, where there is a screen."""
    if not sys.stdout.isatty() or not any(map(os.environ.get, DISPLAYS)):
        return
    import webbrowser

    from robotctl.cli.commands.recordings.report.command import page_of

    webbrowser.open(f"{page_of(shown.path).absolute().as_uri()}#t={shown.at_s or 0.0:.3f}")


def _offset_s(path: Path, row: Mapping[str, Any]) -> float | None:
    """Return how long after the beginning of the recording the row begins, None for all of it."""
    from robotctl.recording import read_info

    start_ns = row.get("start_ns")
    if not isinstance(start_ns, int) or "drives" in row:
        return None
    return max(start_ns - read_info(path).start_ns, 0) / NS_PER_S
