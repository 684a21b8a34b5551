"""The keys of the answers: scripts read them, so keys may be added but never removed."""

from __future__ import annotations

from typing import Any

import pytest

from robotctl.ipc import answers

STABLE = {
    answers.Status: (
        "robot version pid mode phase mode_reason pose velocity battery sim stalls "
        "odometry_dropped topics recorder warnings domain_id discovery_range scheduling socket "
        "uptime_s"
    ),
    answers.TopicAnswer: "name type count rate bytes written queued dropped lost throttled unseen",
    answers.RecorderAnswer: "state file bytes received written queued dropped lost throttled",
    answers.RecordStatus: "topics recorder warnings",
    answers.PoseAnswer: "x y theta",
    answers.VelocityAnswer: "linear angular",
    answers.Preflight: "passed conditions",
    answers.ConditionAnswer: "cause condition problem cure",
    answers.StartSummary: (
        "ready robot mode domain_id discovery_range sim socket pid recording log notes"
    ),
    answers.DrivenPath: "reference driven",
    answers.ModeAnswer: "message mode",
    answers.DriveAnswer: (
        "message mode laps distance_m cross_track_rms_m cross_track_max_m closure_m"
    ),
    answers.Committed: "file uncommitted failure",
    answers.FileSplit: "message finished file",
    answers.Marked: "message text time_ns",
}


@pytest.mark.parametrize(("answer", "keys"), STABLE.items(), ids=lambda each: str(each)[:40])
def test_no_key_of_an_answer_goes_away(answer: Any, keys: str) -> None:
    assert set(keys.split()) - set(answer.__annotations__) == set()
