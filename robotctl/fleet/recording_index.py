"""Makes the index of one recording, with its verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from robotctl.errors import RobotctlError
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import closed_files, files_of, index_path, stamp_of, write_index
from robotctl.processes.report_lines import Report
from robotctl.recording.read.verified import verify_recording
from robotctl.rerun.check import check_recording

NOT_CHECKED: Final = "not checked"
"""The verdicts of a recording that goes on: it is checked and verified when it is complete."""


def index_recording(recording: Path) -> str:
    """Write the index of a recording, with its verdicts; return why that failed, or "".

    Of a recording that goes on, the closed files are indexed. It runs in another process, so that
    it returns its error as a text.
    """
    try:
        files = files_of(recording)
        closed = closed_files(files)
        stamp = stamp_of(closed)
        if len(closed) < len(files):
            rows = rows_of(recording, NOT_CHECKED, None, NOT_CHECKED, closed)
        else:
            verify = verify_recording(recording).proof.value
            report = check_recording(recording)
            says = [each.text for each in report.violations] + report.missing
            rows = rows_of(recording, report.verdict.value, says[0] if says else None, verify)
        write_index(index_path(recording), recording.name, rows, stamp)
    except (RobotctlError, OSError) as error:
        return str(error)
    return ""


def index_job(given: dict[str, Any], report: Report) -> None:
    """Index the recording of a job in a process of its own.

    Raises:
        RobotctlError: It was not indexed.
    """
    failure = index_recording(Path(given["recording"]))
    if failure:
        raise RobotctlError(failure)
