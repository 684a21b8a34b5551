"""`replay --what-if` and `--resim` on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording.format.journal import JournalEntry
from robotctl.testing.drives import Written, drive, drive_requested, record

Cli = Callable[..., Any]


@pytest.fixture(scope="module")
def written() -> list[Written]:
    return drive(23.0, requests=[drive_requested(laps=1)])


@pytest.mark.usefixtures("wide_terminal")
def test_an_open_loop_says_that_the_robot_does_not_react(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), written)
    ran = cli("replay", "run", "--what-if", "tracking.k_y=8")
    assert ran.exit_code == 0
    assert "The robot does not react here" in ran.out
    assert "tracking.k_y                        20.0             8" in ran.out
    assert max(map(len, ran.out.splitlines())) <= 80
    found = json.loads(cli("replay", "run", "--what-if", "tracking.k_y=8", "--json").out)
    assert found["recordings"][0]["angular_rps"]["max"] > 0.0


def test_a_closed_loop_shows_the_error_before_and_after(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), written)
    command = ("replay", "run", "--resim", "--what-if", "sim.lag_s=0.3")
    ran = cli(*command)
    assert ran.exit_code == 0
    (header,) = [line for line in ran.out.splitlines() if "drive 1" in line]
    assert header.split() == ["drive", "1", "recorded", "simulated", "what", "if"]
    (rms,) = [line for line in ran.out.splitlines() if "off track RMS" in line]
    _, simulated, other = map(float, rms.split("[m]")[1].split())
    assert other > simulated
    found = json.loads(cli(*command, "--json").out)["recordings"][0]["drives"][0]
    assert found["what_if"]["cross_track_rms_m"] == pytest.approx(other, abs=1e-4)


def test_a_wrong_key_is_wrong_usage(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), written)
    for setting in ("tracking.k=8", "tracking.k_y=nan", "sim.lag_s=1"):
        assert cli("replay", "run", "--what-if", setting).exit_code == 2
    assert cli("replay", "run", "--check", "--resim").exit_code == 2


def test_a_gap_is_told_and_no_success(cli: Cli, written: list[Written]) -> None:
    entries = [each for each in written if isinstance(each, JournalEntry)]
    record(Path("run"), [*entries[:100], *entries[103:]])
    ran = cli("replay", "run", "--what-if", "tracking.k_y=8")
    assert ran.exit_code == 6
    assert "missing: the journal lacks the entries 100 to 102" in ran.out


def test_settings_may_stand_one_behind_the_other(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), written)
    ran = cli("replay", "run", "--what-if", "tracking.k_y=8", "tracking.k_x=2", "--json")
    assert ran.exit_code == 0
    assert set(json.loads(ran.out)["recordings"][0]["settings"]) == {
        *("tracking.k_y", "tracking.k_x")
    }
    assert cli("replay", "--what-if", "tracking.k_y=8", "tracking.k_x=2").exit_code == 2


@pytest.mark.parametrize("mode", [["--check"], ["--resim"], ["--what-if", "tracking.k_y=8"]])
def test_an_option_that_says_how_to_play_is_refused(
    cli: Cli, written: list[Written], mode: list[str]
) -> None:
    record(Path("run"), written)
    ran = cli("replay", "run", *mode, "--rate", "2")
    assert ran.exit_code == 2
    assert "--rate is only for playing" in ran.err


def test_other_files_in_a_glob_are_skipped(cli: Cli, written: list[Written]) -> None:
    record(Path("recordings/a"), written)
    Path("recordings/README").touch()
    command = ("replay", "recordings/README", "recordings/a", "--what-if", "tracking.k_y=8")
    ran = cli(*command)
    assert (ran.exit_code, ran.err) == (0, "")
    assert ran.out.splitlines()[-1] == "skipped     recordings/README: not a recording"
    assert json.loads(cli(*command, "--json").out)["skipped"] == ["recordings/README"]
