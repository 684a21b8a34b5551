"""`robotctl gate`, as a user and a continuous integration type it."""

from __future__ import annotations

import getpass
import os
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from robotctl.cli.ui import text
from robotctl.collection import judging
from robotctl.testing.drives import drive, drive_requested, record
from tests.cli.conftest import Cli
from tests.support.checked_drives import here

RECORDINGS = Path("recordings")
LAP = RECORDINGS / "robot_20260101_120000"
SLOW = ("--what-if", "limits.linear_mps=0.05", "--what-if", "tracking.max_error_m=0.05")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    return record(folder / LAP.name, drive(2.0))


@pytest.fixture
def lap(made: Path) -> None:
    """A recording in ./recordings."""
    shutil.copytree(made, LAP)


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judging, "judge_here", here)


@pytest.mark.usefixtures("lap")
def test_machines_are_told_who_accepted_what_and_why(cli: Cli) -> None:
    same = cli("gate", "--json", "--junit", "gate.xml").summary
    assert (same["failed"], same["counts"]["same"]) == (0, 1)
    assert LAP.name in Path("gate.xml").read_text()
    assert cli("gate").exit_code == 0
    assert cli("gate", *SLOW).exit_code == 7
    accepting = ("--baseline", "accepted.json", "--accept", "the base is slower")
    assert cli("gate", *SLOW, *accepting).exit_code == 0
    found = cli("gate", *SLOW, "--baseline", "accepted.json", "--json").summary
    (recording,) = found["recordings"]
    assert recording["state"] == "accepted"
    at = recording["accepted"].pop("at")
    assert recording["accepted"] == {"by": getpass.getuser(), "why": "the base is slower"}
    lines = cli("gate", *SLOW, "--baseline", "accepted.json").out.splitlines()
    said = f"      1  accepted by {getpass.getuser()} at {at}: the base is slower"
    assert lines[2:4] == [said, f"         {LAP.name}"]
    assert cli("gate", "--accept", "why").exit_code == 2


@pytest.mark.usefixtures("lap")
@pytest.mark.parametrize("problem", [KeyError("uid"), OSError("no username")])
def test_a_user_without_a_name_may_accept(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, problem: Exception
) -> None:
    def unknown() -> str:
        raise problem

    monkeypatch.setattr(getpass, "getuser", unknown)
    cli("gate", *SLOW, "--baseline", "accepted.json", "--accept", "slow").succeeded(
        f"accepted by uid {os.getuid()} at"
    )


@pytest.mark.parametrize("where", ["here", "a link", "files"])
def test_a_gate_that_finds_no_recordings_is_refused(cli: Cli, made: Path, where: str) -> None:
    RECORDINGS.mkdir()
    if where == "a link":
        (RECORDINGS / "robot").symlink_to(made)
    elif where == "files":
        (RECORDINGS / "notes.txt").touch()
    cli("gate", "--in", "recordings", "--junit", "gate.xml").failed(
        4, "recordings holds no recordings, so nothing was judged: give --in"
    )
    assert not Path("gate.xml").exists()


@pytest.mark.usefixtures("lap")
@pytest.mark.parametrize("option", ["--junit", "--baseline"])
@pytest.mark.parametrize("file", ["no/such/folder/file", "recordings"])
def test_a_file_that_cannot_be_written_is_told_before_the_judging(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, option: str, file: str
) -> None:
    monkeypatch.setattr(judging, "judge_here", lambda *_: pytest.fail("it was judged"))
    accept = ("--accept", "why") if option == "--baseline" else ()
    ran = cli("gate", *SLOW, option, file, *accept)
    assert ran.exit_code in (2, 4)
    assert file in ran.err


@pytest.mark.usefixtures("lap")
@pytest.mark.parametrize(("parameters", "exit_code"), [((), 4), (SLOW, 7)])
def test_an_answer_that_was_judged_is_printed_although_its_report_cannot_be_written(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, parameters: tuple[str, ...], exit_code: int
) -> None:
    engine = partial(here)

    def judge_and_disturb(*arguments: Any) -> Any:
        yield from engine(*arguments)
        Path("reports").rename("moved")

    Path("reports").mkdir()
    monkeypatch.setattr(judging, "judge_here", judge_and_disturb)
    cli("gate", *parameters, "--junit", "reports/gate.xml").failed(
        exit_code, "cannot write reports/gate.xml", out="1 recordings: 1 same"
    )


def test_a_what_if_tells_drives_before_and_after(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "_terminal_columns", lambda: 80)
    record(LAP, drive(20.0, requests=[drive_requested(laps=1)]))
    record(RECORDINGS / "still", drive(0.5, requests=[]))
    slow = ("--what-if", "limits.linear_mps=0.2")
    lines = cli("gate", *slow).out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "  1 of 1 drives end otherwise" in lines
    (title,) = (each for each in lines if each.startswith(f"  {LAP.name}, drive 1: "))
    assert title.split(": ")[1].startswith("1 lap, 4.")
    assert any("the robot does not react" in each for each in lines)
    found = cli("gate", *slow, "--json").summary
    drives = {Path(each["path"]).name: each["other"]["drives"] for each in found["recordings"]}
    assert drives["still"] == []
    (one,) = drives[LAP.name]
    before, after = one["recorded"], one["what_if"]
    assert (one["measured"]["laps"], before["completed"], before["end_mode"]) == (1, True, "IDLE")
    assert "laps" not in after, "how far the robot would have come is not known"
    assert after["max_linear_mps"] == pytest.approx(0.2)
    assert after["commanded_m"] < before["commanded_m"]
    assert before["commanded_m"] == pytest.approx(one["measured"]["distance_m"], abs=0.1)
    assert (after["cause"], after["end_mode"]) == ("tracking lost", "ERROR")
    totals = found["totals"]
    assert (totals["drives"], totals["end_otherwise"]) == (1, 1)
    assert totals["commanded_m"] == {
        "recorded": before["commanded_m"],
        "what_if": after["commanded_m"],
    }
