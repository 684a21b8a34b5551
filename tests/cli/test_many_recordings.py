"""`robotctl find` and `index`, as a user types them; recordings are indexed in processes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.testing.drives import drive, drive_requested, record

pytest.importorskip("duckdb", reason="indexes are an extra: robotctl[parquet]")

Cli = Callable[..., Any]
LAP = Path("recordings/robot_20260101_120000")


def test_a_user_finds_the_drives_of_a_folder(cli: Cli) -> None:
    record(LAP, drive(20.0, requests=[drive_requested(laps=1)]))
    ran = cli("find", "laps >= 1")
    assert ran.exit_code == 0
    assert LAP.name in ran.out
    assert ran.out.endswith("1 row\n")
    found = json.loads(cli("find", "--recordings", "--json").out)
    assert found["left_out"] == []
    assert found["rows"][0]["recording"] == LAP.name
    indexed = json.loads(cli("index", "--json").out)
    assert indexed["indexed"] == 1
    counted = cli("find", "--sql", "SELECT count(*) AS drives FROM drives").out
    assert counted.split() == ["drives", "1", "1", "row"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--recordings", "--events"), "two tables"),
        (("laps > 1", "--sql", "SELECT 1"), "a whole question"),
        (("--in", "nowhere"), "no such folder"),
    ],
)
def test_options_that_contradict_each_other_are_named(
    cli: Cli, arguments: tuple[str, ...], says: str
) -> None:
    ran = cli("find", *arguments)
    assert ran.exit_code == 2
    assert says in " ".join(ran.err.split())


def test_a_recording_that_cannot_be_indexed_has_an_exit_code(cli: Cli) -> None:
    folder = Path("recordings/broken")
    folder.mkdir(parents=True)
    (folder / "broken_0.mcap").write_bytes(b"no MCAP")
    ran = cli("index", "recordings")
    assert ran.exit_code == 6
    assert "broken is left out: " in ran.out


def test_the_gate_passes_what_is_decided_the_same_and_tells_machines(cli: Cli) -> None:
    record(LAP, drive(2.0))
    assert cli("gate").exit_code == 0
    found = json.loads(cli("gate", "--json", "--junit", "gate.xml").out)
    assert (found["stored"], found["failed"], found["counts"]["same"]) == (1, 0, 1)
    assert LAP.name in Path("gate.xml").read_text()
    slow = ("--what-if", "limits.linear_mps=0.05", "--what-if", "tracking.max_error_m=0.05")
    assert cli("gate", *slow).exit_code == 7
    accepted = ("--baseline", "accepted.json", "--accept", "the base is slower")
    assert cli("gate", *slow, *accepted).exit_code == 0
    assert "the base is slower" in Path("accepted.json").read_text()
    assert cli("gate", "--accept", "why").exit_code == 2
