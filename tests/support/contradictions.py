"""What a check finds in the recordings that a test leaves behind."""

from __future__ import annotations

from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.recording import Recording
from robotctl.recording.format.metadata_names import INFO_RECORD
from robotctl.recording.keep.catalog import CLIPS_FOLDER
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict


def contradictions(folder: Path, *, may_lack: bool, killed: bool) -> list[str]:
    """Return the recordings below a folder, also clips, that a check does not call the same.

    They may be incomplete if they `may_lack` something; clips may always, and so may a recording
    whose daemon was `killed` before its first entry was on the disk.
    """
    recordings = {
        path if path.parent.name == CLIPS_FOLDER else path.parent for path in folder.rglob("*.mcap")
    }
    return [
        f"recording: {report.as_object()}"
        for report in map(check_recording, sorted(recordings))
        if report.verdict in (Verdict.DIVERGED, Verdict.BROKEN)
        or (
            report.verdict is Verdict.INCOMPLETE
            and not may_lack
            and (report.events or not killed)
            and _decides(report)
        )
    ]


def _decides(report: Report) -> bool:
    """Return whether a recording is of a daemon that decides: it names its topics.

    A clip is none: what it lacks at its cut its source may have.
    """
    if report.path.parent.name == CLIPS_FOLDER:
        return False
    try:
        with Recording(report.path) as recording:
            return "topic.robot_status" in recording.info().metadata.get(INFO_RECORD, {})
    except UnreadableFile:
        return False
