"""A baseline of the gate accepts what a person saw, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from robotctl.collection import judgement
from robotctl.collection.gate import Baseline, GateReport, read_baseline
from robotctl.errors import ConfigError
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.types import Effect, Event
from robotctl.rerun import check_report, rerun
from robotctl.rerun.rerun import Comparison
from robotctl.testing.drives import BEGIN_NS, drive, record
from tests.support.checked_drives import judged, rechained, wrong

NAME = "robot_20260101_120000"
SLOW = {"limits.linear_mps": "0.05", "tracking.max_error_m": "0.05"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    record(folder / NAME, drive(2.0))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "recordings"))


def accepted(report: GateReport, file: Path) -> Baseline:
    """Accept what is wrong, and return the baseline as the next run reads it."""
    baseline = read_baseline(file)
    for path, result in (report.failures() | report.unknown()).items():
        baseline.accept(path.name, result, by="ann", why="a shorter ramp", at="2026-01-01")
    baseline.write(file)
    return read_baseline(file)


def test_what_is_accepted_passes_and_says_by_whom(folder: Path, tmp_path: Path) -> None:
    record(folder / "other", wrong(drive(2.0)))
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    again = judged(folder, baseline)
    assert again.failures() == {}
    assert again.acceptances() == {("ann", "2026-01-01", "a shorter ramp"): [folder / "other"]}


def test_one_accepted_what_if_passes_no_other(folder: Path, tmp_path: Path) -> None:
    baseline = accepted(judged(folder, settings=SLOW), tmp_path / "baseline.json")
    assert judged(folder, baseline, SLOW).failures() == {}
    for settings in (
        SLOW | {"limits.linear_mps": "0.04"},
        {"limits.linear_mps": "0.02", "tracking.max_error_m": "0.02"},
        SLOW | {"tracking.k_y": "7.0"},
    ):
        assert list(judged(folder, baseline, settings).failures()) == [folder / NAME], settings


def test_an_accepted_number_passes_no_other_number(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same bytes, which a later kernel decides differently from the accepted difference."""
    record(folder / "other", wrong(drive(2.0)))
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    differences = Comparison.differences
    monkeypatch.setattr(
        Comparison,
        "differences",
        lambda *them: [each.replace("decided 0.", "decided 1.") for each in differences(*them)],
    )
    shutil.rmtree(folder / ".gate")
    again = judged(folder, baseline)
    assert list(again.failures()) == [folder / "other"]


def test_an_accepted_divergence_passes_no_later_one(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = drive(2.0, snapshots_s=(0.0, 1.0))
    end = next(n for n, each in enumerate(written) if n and getattr(each, "name", "") == "Snapshot")
    record(folder / "other", rechained([*wrong(written[:end]), *written[end:]]))
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    assert judged(folder, baseline).failures() == {}
    step = Kernel.step

    def silent_later(kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        effects = step(kernel, event)
        return () if event.t_ns > BEGIN_NS + 1_500_000_000 else effects

    monkeypatch.setattr(Kernel, "step", silent_later)
    shutil.rmtree(folder / ".gate")
    assert folder / "other" in judged(folder, baseline).failures()


def test_what_was_accepted_passes_with_the_next_version_too(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(folder / "other", wrong(drive(2.0)))
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    for module in (check_report, rerun, judgement):
        monkeypatch.setattr(module, "__version__", "9.9.9")
    shutil.rmtree(folder / ".gate")
    again = judged(folder, baseline)
    assert list(again.accepted) == [folder / "other"]
    assert "recorded by" in again.results[folder / "other"].says


def test_another_recording_with_the_same_difference_is_not_accepted(
    folder: Path, tmp_path: Path
) -> None:
    record(folder / "other", wrong(drive(2.0)))
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    shutil.rmtree(folder / "other")
    record(folder / "other", wrong(drive(2.5)))
    assert list(judged(folder, baseline).failures()) == [folder / "other"]


def test_the_place_of_a_recording_makes_no_difference(folder: Path, tmp_path: Path) -> None:
    (file,) = (folder / NAME).glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-200])
    baseline = accepted(judged(folder), tmp_path / "baseline.json")
    elsewhere = Path(shutil.copytree(folder, tmp_path / "elsewhere"))
    shutil.rmtree(elsewhere / ".gate")
    again = judged(elsewhere, baseline)
    assert list(again.accepted) == [elsewhere / NAME]


def test_a_baseline_of_an_older_robotctl_is_refused_with_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    old = ("name", "recording", "verdict", "cause", "by", "why", "at")
    file.write_text(json.dumps({"accepted": [dict.fromkeys(old, "")]}))
    with pytest.raises(ConfigError, match=r"an older robotctl wrote it.*: name a new file"):
        read_baseline(file)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "[", "[" * 100_000),
        *('{"format": 2, "accepted": [{"name": 1}]}', '{"format": 3, "accepted": []}'),
    ],
)
def test_a_wrong_baseline_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "baseline.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match="is not a baseline"):
        read_baseline(file)
