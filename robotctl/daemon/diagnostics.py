"""The daemon on /diagnostics: the state of its recorder, and every warning of `status`."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Final

from robotctl.daemon.api.status import StatusSource
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.ros.nodes.publishers import (
    Diagnosis,
    DiagnosticLevel,
    DiagnosticsPublisher,
)
from robotctl.ros.session import Session

PERIOD_S: Final = 1.0

MAX_WARNINGS: Final = 100
"""Limit on the warnings that are listed."""


class Diagnostics:
    """Samples the recorder's rates and publishes both diagnoses, once a second."""

    def __init__(
        self, session: Session, robot: str, recorder: RecorderReport, status: StatusSource
    ) -> None:
        self._publisher = DiagnosticsPublisher(session, robot)
        self._recorder = recorder
        self._status = status

    async def run(self) -> None:
        """Publish until cancelled."""
        while True:
            self._recorder.sample(self._recorder.stats())
            self.publish()
            await asyncio.sleep(PERIOD_S)

    def publish(self) -> None:
        """Publish once."""
        stats = self._recorder.stats()
        warnings = self._status.warnings(stats)
        self._publisher.publish(self._recorder.diagnosis(stats), diagnose(warnings))


def diagnose(warnings: Sequence[str]) -> Diagnosis:
    """Return the diagnosis of the daemon: WARN where `status` warns of something, else OK."""
    values = {f"warning {n}": text for n, text in enumerate(warnings[:MAX_WARNINGS], start=1)}
    if not warnings:
        return Diagnosis("daemon", DiagnosticLevel.OK, "no warnings", values)
    others = f" (and {len(warnings) - 1} more)" if len(warnings) > 1 else ""
    return Diagnosis("daemon", DiagnosticLevel.WARN, f"{warnings[0]}{others}", values)
