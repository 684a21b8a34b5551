"""A recordings folder at any path is used, or the start fails with the reason."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from robotctl.config import Config
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.errors import Refused
from robotctl.recording import Recorder, read_info
from tests.support.world import World

STEERING = "rec\n\x1b[2J\x1b[31mordings"


def start_and_stop(world: World, recordings: str) -> str:
    out = world.ok("start", "--observe", "--recordings", recordings)
    return out + world.ok("status") + world.ok("stop") + world.ok("logs")


def test_folders_that_are_missing_are_made(world: World) -> None:
    recordings = "a/../b c/d"
    (world.folder / "a").mkdir()
    start_and_stop(world, recordings)
    (recorded,) = (world.folder / recordings).iterdir()
    assert read_info(recorded).missing == ()


def test_a_name_that_steers_a_terminal_is_shown_escaped(world: World) -> None:
    said = start_and_stop(world, STEERING)
    (recorded,) = (world.folder / STEERING).iterdir()
    assert read_info(recorded).missing == ()
    assert r"rec\n\x1b[2J\x1b[31mordings" in said
    assert all(line.isprintable() for line in said.splitlines())
    assert "\x1b" not in world.log()


def unexpected(told: object) -> None:
    pytest.fail(str(told))


def opened(recordings: Path) -> Recorder:
    return open_recorder(
        recordings, "robot", Config(), lambda: "IDLE", unexpected, unexpected, unexpected
    )


@pytest.mark.parametrize(
    ("recordings", "why"),
    [
        ("file", "Not a directory"),
        ("file/below", "Not a directory"),
        ("dangling", "File exists"),
        ("/sys/robotctl-recordings", ""),  # where not even root can make a folder
    ],
)
def test_where_nothing_can_be_recorded_nothing_is_touched(
    tmp_path: Path, recordings: str, why: str
) -> None:
    (tmp_path / "file").write_text("somebody's")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(Refused, match=f"cannot record into .*{why}"):
        opened(tmp_path / recordings)
    assert (tmp_path / "file").read_text() == "somebody's"
    assert not (tmp_path / "nowhere").exists()


def test_where_nothing_can_be_recorded_nothing_is_started(world: World) -> None:
    (world.folder / "file").write_text("somebody's")
    ran = world.robotctl("start", "--observe", "--recordings", "file/below")
    assert ran.exit_code == 4, ran
    assert ran.err.startswith("robotctl: cannot record into ")
    assert "Not a directory" in ran.err
    assert "choose another folder (--recordings)" in ran.err
    assert world.processes() == {}


def test_a_link_with_the_name_of_the_new_recording_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda form: "20260101_120000")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    (recordings / "robot_20260101_120000").symlink_to(elsewhere)
    (recordings / "robot_20260101_120000-2").symlink_to(tmp_path / "nowhere")
    recorder = opened(recordings)
    assert recorder.close().file.parent == recordings / "robot_20260101_120000-3"
    assert list(elsewhere.iterdir()) == []
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("option", ["--include", "--exclude"])
@pytest.mark.parametrize("pattern", ["/a\n/b", "/\x1b[2J", "camera", "", "/a,", "type:", "/a b"])
def test_a_pattern_that_names_no_topic_is_refused_and_shown_escaped(
    world: World, option: str, pattern: str
) -> None:
    ran = world.here("start", "--observe", option, pattern)
    assert ran.exit_code == 2
    assert ran.err.startswith(f"robotctl: {option}: ")
    assert "use a topic (/scan), a glob (/camera/*) or a type" in ran.err
    assert ran.err.rstrip("\n").isprintable()
    assert not world.recordings.exists()
