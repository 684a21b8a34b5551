"""The cures in a daemon's messages name its robot."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robotctl.daemon.api.recording import recording_methods
from robotctl.daemon.api.status import StatusSource
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.recorder_report import RecorderReport
from robotctl.errors import Refused
from robotctl.ipc.answers import RobotFacts
from robotctl.ipc.params import MarkParams, NoParams
from robotctl.recording import Recorder
from robotctl.recording.write.recorder import RecorderState, RecorderStats
from robotctl.recording.write.recorder_options import TopicFilter
from robotctl.ros.tap.tap import Tap

FAILURE = "the recorder failed: see robotctl logs"
FAILURE_OF_R2 = f"{FAILURE} --robot r2"


@pytest.fixture
def report() -> RecorderReport:
    facts = {"topics": [], "recorder": {"file": "run.mcap"}}
    fake = SimpleNamespace(
        stats=lambda: None, facts=lambda _: facts, warnings=lambda _: iter([FAILURE])
    )
    return cast(RecorderReport, fake)


async def test_a_failed_recorder_names_the_robot_in_its_cure(report: RecorderReport) -> None:
    stats = SimpleNamespace(received=1, written=1, dropped=0, file="run.mcap")
    recorder = SimpleNamespace(
        failure=FAILURE, report=report, stats=lambda: stats, split=lambda: None
    )
    methods = recording_methods(cast(FlightRecorder, recorder), "r2")
    status: Any = await methods["record_status"].handler(NoParams())
    assert status["warnings"] == [FAILURE_OF_R2]
    commit: Any = await methods["record_commit"].handler(NoParams())
    assert commit["failure"] == FAILURE_OF_R2
    for name, params in (("record_split", NoParams()), ("mark", MarkParams("here", "test"))):
        with pytest.raises(Refused, match=f"{FAILURE_OF_R2}$"):
            await methods[name].handler(params)


def test_the_notes_of_a_start_name_the_robot_in_a_cure(report: RecorderReport) -> None:
    robot: Any = SimpleNamespace(
        facts=lambda: dict.fromkeys(RobotFacts.__required_keys__),
        remedies=lambda: (),
        warnings=lambda: iter(()),
    )
    options = DaemonOptions("r2", None, Path(), None, None, 0)
    source = StatusSource(options, report, robot, "", [])
    note = "moving is refused: no odometry: (robotctl status lists the topics)"
    (told,) = source.summary([note])["notes"]
    assert "(robotctl status --robot r2 lists the topics)" in told


def test_diagnostics_on_ros_name_the_robot_in_a_cure() -> None:
    failed = RecorderStats(
        state=RecorderState.FAILED,
        file=Path("run.mcap"),
        bytes=0,
        received=0,
        written=0,
        queued=0,
        dropped=0,
        lost=0,
        unseen=0,
        not_repeated=0,
        no_memory=0,
        failure=FAILURE,
        warning="",
        topics=(),
    )
    silent = SimpleNamespace(warnings=lambda: iter(()))
    report = RecorderReport(
        cast(Recorder, SimpleNamespace(stats=lambda: failed)),
        cast(Tap, SimpleNamespace(unrecorded=silent, mismatches=silent)),
        TopicFilter((), (), ()),
        list,
        "r2",
    )
    assert report.diagnosis(report.stats()).message == FAILURE_OF_R2
