"""convert: its options, its answers, its exit codes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.recording import Recorder
from tests.cli.conftest import Ran

GOLDEN = Path(__file__).parents[1] / "golden"

Cli = Callable[..., Ran]


def test_the_answer_names_the_new_files_and_counts_the_messages(cli: Cli, tmp_path: Path) -> None:
    target = tmp_path / "copy"
    ran = cli("convert", str(GOLDEN / "foreign"), str(target), "--json")
    assert (ran.exit_code, ran.err) == (0, "")
    assert json.loads(ran.out) == {
        "source": str(GOLDEN / "foreign"),
        "target": str(target),
        "files": ["copy_0.mcap", "copy_1.mcap"],
        "messages": 586,
        "attachments": 0,
        "live": False,
        "lost": [],
    }
    ran = cli("convert", str(target), str(tmp_path / "one.mcap"), "--compression", "lz4")
    assert ran.out.endswith("one.mcap: 586 messages in 1 file\n")
    assert (tmp_path / "one.mcap").is_file()


def test_a_loss_is_told_and_is_code_8(cli: Cli, tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "foreign", tmp_path / "run")
    next((tmp_path / "run").glob("*_1.mcap")).unlink()
    ran = cli("convert", str(tmp_path / "run"), str(tmp_path / "copy"))
    assert (ran.exit_code, "97 messages in 1 file" in ran.out) == (8, True)
    assert "could not be converted completely: robot_20261122_041528_1.mcap" in ran.err


def test_of_a_recording_that_goes_on_the_answer_says_so(cli: Cli, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=print)
    try:
        ran = cli("convert", str(tmp_path / "run"), str(tmp_path / "copy"))
    finally:
        recorder.close()
    assert ran.exit_code == 0
    assert ran.err == f"robotctl: {tmp_path}/run is still being recorded: the copy ends here\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["out", "--split-mb", "5", "--one-file"], "--split-mb makes several files: give a folder"),
        (["out.mcap", "--split-mb", "5"], "--split-mb makes several files: give a folder"),
        (["out", "--split-mb", "0"], "Invalid value for '--split-mb'"),
        (["out", "--compression", "zip"], "Invalid value for '--compression'"),
    ],
)
def test_options_that_do_not_fit_are_refused(cli: Cli, arguments: list[str], sentence: str) -> None:
    ran = cli("convert", str(GOLDEN / "stopped"), *arguments)
    assert (ran.exit_code, ran.err.startswith(f"robotctl: {sentence}")) == (2, True), ran.err
    assert not Path("out").exists()


def test_what_is_no_recording_is_named(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for source in (tmp_path / "empty", tmp_path / "nothing", Path("/dev/null")):
        ran = cli("convert", str(source), str(tmp_path / "copy"))
        assert (ran.exit_code, str(source) in ran.err) == (6, True), ran.err
        assert not (tmp_path / "copy").exists()
