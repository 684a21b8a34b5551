"""`recordings rm` removes what robotctl recorded, after a question, and nothing else."""

from __future__ import annotations

import json
import os
import pty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import Interrupted, Refused
from robotctl.cli.commands.recordings import remove
from robotctl.recording import Recorder
from robotctl.recording.keep.listing import CLIPS_FOLDER, set_kept
from robotctl.testing.drives import TWIST
from tests.support.recordings import write_numbered

Cli = Callable[..., Any]

NAME = "robot_20260101_120000"


@pytest.fixture
def recorder(tmp_path: Path) -> Recorder:
    recorder = Recorder(tmp_path / "cwd" / "recordings" / NAME, on_failure=pytest.fail)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 10))
    return recorder


@pytest.fixture
def folder(recorder: Recorder) -> Path:
    file = recorder.close().file
    clips = file.parent / CLIPS_FOLDER
    clips.mkdir()
    (clips / "estop.mcap").write_bytes(file.read_bytes())
    return file.parent


def test_a_recording_goes_with_its_clips(folder: Path, cli: Cli) -> None:
    ran = cli("recordings", "rm", NAME, "--yes", "--json")
    assert ran.exit_code == 0
    assert json.loads(ran.out)["removed_bytes"] > 1000
    assert not folder.exists()


def test_what_others_put_into_the_folder_stays(folder: Path, cli: Cli) -> None:
    (folder / "notes.txt").write_text("mine")
    assert cli("recordings", "rm", NAME, "-y").exit_code == 0
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_without_a_terminal_nothing_is_removed_unasked(folder: Path, cli: Cli) -> None:
    ran = cli("recordings", "rm", "last")
    assert (ran.exit_code, "give --yes" in ran.err) == (2, True)
    assert folder.exists()


@pytest.mark.parametrize(("answer", "is_removed"), [("y", True), ("n", False), ("", False)])
def test_only_yes_means_yes(
    answer: str, is_removed: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = pty.openpty()
    os.write(ours, f"{answer}\n".encode())
    with os.fdopen(theirs, closefd=True) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        if is_removed:
            assert remove(folder, without_asking=False) > 0
        else:
            with pytest.raises(Interrupted, match="nothing was removed"):
                remove(folder, without_asking=False)
    os.close(ours)
    assert folder.exists() is not is_removed


def test_a_kept_recording_is_refused(folder: Path, cli: Cli) -> None:
    set_kept(folder, True)
    ran = cli("recordings", "rm", NAME, "--yes")
    assert (ran.exit_code, f"recordings unkeep {NAME}" in ran.err) == (4, True)
    assert folder.exists()


def test_a_recording_that_is_being_written_is_refused(recorder: Recorder, cli: Cli) -> None:
    ran = cli("recordings", "rm", NAME, "--yes")
    assert (ran.exit_code, "is being recorded" in ran.err) == (4, True)
    assert recorder.close().file.exists()


def test_a_folder_without_a_recording_and_a_link_are_refused(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to(folder)
    empty = folder.parent / "empty"
    empty.mkdir()
    for path in (link, empty, folder.parent / "none", next(folder.glob("*.mcap"))):
        with pytest.raises(Refused, match="is not the folder of a recording"):
            remove(path, without_asking=True)
    assert folder.exists()
