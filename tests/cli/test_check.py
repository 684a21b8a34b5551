"""`replay --check` on the command line: what it prints, and its exit code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording.format.journal import JournalEntry
from robotctl.testing.drives import Written, drive, record

Cli = Callable[..., Any]


@pytest.fixture(scope="module")
def written() -> list[Written]:
    return drive(1.0)


def diverging(written: list[Written]) -> list[Written]:
    """Return the same drive with another last command."""
    changed = list(written)
    position = max(
        i
        for i, each in enumerate(changed)
        if isinstance(each, JournalEntry) and each.name == "PublishTwist"
    )
    entry = changed[position]
    assert isinstance(entry, JournalEntry)
    changed[position] = entry._replace(data=entry.data.replace('"angular":0.0', '"angular":0.5'))
    return changed


def test_a_recording_that_is_decided_the_same_is_said_in_two_lines(
    cli: Cli, written: list[Written]
) -> None:
    record(Path("run"), written)
    ran = cli("replay", "run", "--check")
    assert ran.exit_code == 0
    first, second = ran.out.splitlines()
    assert first.split() == ["same", "run"]
    assert "bit for bit" in second


def test_many_are_checked_and_the_gravest_decides_the_exit_code(
    cli: Cli, written: list[Written]
) -> None:
    record(Path("recordings/a"), written)
    record(Path("recordings/b"), written)
    assert cli("replay", "recordings", "--check").exit_code == 0
    Path("recordings/c").mkdir()
    Path("recordings/c/c_0.mcap").write_bytes(b"no recording")
    ran = cli("replay", "recordings", "--check", "--json")
    assert ran.exit_code == 6
    assert [each["verdict"] for each in json.loads(ran.out)["recordings"]] == [
        *("same", "same"),
        "incomplete",
    ]
    record(Path("recordings/d"), diverging(written))
    ran = cli("replay", "recordings", "--check")
    assert ran.exit_code == 7
    assert "1 of 4 recordings would be decided differently" in ran.err


@pytest.mark.usefixtures("wide_terminal")
def test_a_divergence_is_told_with_what_led_to_it(cli: Cli, written: list[Written]) -> None:
    record(Path("run"), diverging(written))
    ran = cli("replay", "run", "--check")
    assert ran.exit_code == 7
    told = " ".join(ran.out.split())
    assert "before MOVING, driving a square, command 0." in told
    assert 'event Tick {"t_ns":' in told
    assert "differs twist.angular: recorded 0.5, decided 0.0" in told
    assert max(map(len, ran.out.splitlines())) <= 80
    found = json.loads(cli("replay", "run", "--check", "--json").out)["recordings"][0]["divergence"]
    assert found["mode"] == "MOVING"
    assert found["state"]["drive"]["pattern"]["kind"] == "square"


def test_what_cannot_be_read_is_no_success(cli: Cli) -> None:
    Path("empty.mcap").touch()
    ran = cli("replay", "nowhere", "empty.mcap", "--check")
    assert ran.exit_code == 6
    assert "2 of 2 recordings could not be checked completely" in ran.err
    assert "it is empty" in ran.out


def test_no_ros_is_imported(written: list[Written]) -> None:
    record(Path("run"), written)
    program = """
import sys
from robotctl.cli.app import run
assert run(["replay", "run", "--check"]) == 0
assert "rclpy" not in sys.modules
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr


def test_the_last_recording_may_be_meant(cli: Cli, written: list[Written]) -> None:
    record(Path("recordings/robot_20260101_120000"), written)
    ran = cli("replay", "last", "--check")
    assert ran.exit_code == 0
    assert "robot_20260101_120000" in ran.out


def test_other_files_in_a_glob_are_skipped_with_a_line_each(
    cli: Cli, written: list[Written]
) -> None:
    record(Path("recordings/a"), written)
    Path("recordings/README").write_text("where recordings go\n")
    Path("recordings/notes").mkdir()
    Path("recordings/notes/path.png").touch()
    os.mkfifo("recordings/pipe")
    glob = sorted(map(str, Path("recordings").iterdir()))
    ran = cli("replay", *glob, "--check")
    assert (ran.exit_code, ran.err) == (0, "")
    assert ran.out.splitlines()[2:] == [
        f"skipped     recordings/{name}: not a recording" for name in ("README", "notes", "pipe")
    ]
    answer = json.loads(cli("replay", *glob, "--check", "--json").out)
    assert answer["skipped"] == [f"recordings/{name}" for name in ("README", "notes", "pipe")]
    assert len(answer["recordings"]) == answer["same"] == 1


@pytest.mark.parametrize("name", ["torn.mcap", "bag", "nowhere", "packed.mcap.zstd"])
def test_what_may_be_a_recording_is_not_skipped(
    name: str, cli: Cli, written: list[Written]
) -> None:
    record(Path("whole"), written)
    Path("torn.mcap").write_bytes(b"nothing")
    Path("packed.mcap.zstd").write_bytes(b"nothing")
    Path("bag").mkdir()
    Path("bag/metadata.yaml").touch()
    ran = cli("replay", "whole", name, "--check")
    assert ran.exit_code == 6
    assert f"incomplete  {name}\n" in ran.out


def test_a_recording_under_another_name_is_known_by_its_first_bytes(
    cli: Cli, written: list[Written]
) -> None:
    (file,) = record(Path("whole"), written).glob("*.mcap")
    file.rename("renamed.bin")
    record(Path("other"), written)
    assert cli("replay", "other", "renamed.bin", "--check").out.count("same ") == 2


def test_nothing_but_other_files_is_an_error(cli: Cli) -> None:
    Path("README").touch()
    Path("NOTES").touch()
    assert cli("replay", "README", "--check").exit_code == 6
    ran = cli("replay", "README", "NOTES", "--check")
    assert ran.exit_code == 6
    assert "skipped" not in ran.out
