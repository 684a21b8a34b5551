"""The methods of the control socket for the recording."""

from __future__ import annotations

from typing import Any

from robotctl.base.errors import Refused
from robotctl.daemon.api.warnings import of_recording
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.waiting import until
from robotctl.ipc.advice import for_robot
from robotctl.ipc.answers import Committed, FileSplit, Marked, RecordStatus
from robotctl.ipc.method_names import MARK, RECORD_COMMIT, RECORD_SPLIT, RECORD_STATUS
from robotctl.ipc.method_params import MarkParams, NoParams
from robotctl.ipc.request_handler import Method

SPLIT_DEADLINE_S = 5.0
"""How long the disk may take to finish one file and start the next."""

COMMIT_DEADLINE_S = 5.0
"""How long the disk may take to write the queue; the recorder writes four times a second."""


def recording_methods(recorder: FlightRecorder, robot: str) -> dict[str, Method[Any]]:
    """Return methods for status, commit, split and mark; errors suggest commands for `robot`."""

    def failure() -> str:
        return for_robot(recorder.failure, robot)

    async def status(_: NoParams) -> RecordStatus:
        stats = recorder.stats()
        return {
            **recorder.report.facts(stats),
            "warnings": [for_robot(text, robot) for text in of_recording(recorder, stats)],
        }

    async def commit(_: NoParams) -> Committed:
        """Answer when the file has all messages received so far, or after COMMIT_DEADLINE_S."""
        received = recorder.stats().received

        def uncommitted() -> int:
            stats = recorder.stats()
            return max(received - stats.written - stats.dropped, 0)

        await until(lambda: bool(recorder.failure) or not uncommitted(), COMMIT_DEADLINE_S)
        return {
            "file": _file_of(recorder),
            "uncommitted": uncommitted(),
            "failure": failure(),
        }

    async def split(_: NoParams) -> FileSplit:
        before = _file_of(recorder)
        recorder.split()
        if not await until(
            lambda: bool(recorder.failure) or _file_of(recorder) != before, SPLIT_DEADLINE_S
        ):
            raise Refused("the disk is too slow: the next file starts as soon as it can")
        if recorder.failure:
            raise Refused(failure())
        file = _file_of(recorder)
        return {"message": f"Recording continues in {file}", "finished": before, "file": file}

    async def mark(params: MarkParams) -> Marked:
        if recorder.failure:
            raise Refused(failure())
        event = recorder.mark(params.text, params.source)
        return {"message": "Marked", "text": params.text, "time_ns": event.log_ns}

    return {
        RECORD_STATUS: Method(NoParams, status),
        RECORD_COMMIT: Method(NoParams, commit),
        RECORD_SPLIT: Method(NoParams, split, 2 * SPLIT_DEADLINE_S),
        MARK: Method(MarkParams, mark),
    }


def _file_of(recorder: FlightRecorder) -> str:
    return str(recorder.stats().file)
