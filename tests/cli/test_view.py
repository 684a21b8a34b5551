"""`robotctl view` of a recording, and its refusals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.cli.support import view_process
from tests.cli.conftest import Ran
from tests.support.numbered_files import recorded
from tests.support.view_client import view_client


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A small recording."""
    return recorded(tmp_path / "run", 100)


async def test_a_recording_is_shown_without_ros_until_ctrl_c(
    file: Path, spawn: Callable[..., subprocess.Popen[str]]
) -> None:
    process = spawn("view", str(file), "--port", "0", "--json")
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    maps = _maps_of_children(process.pid)
    assert maps
    assert "librcl" not in maps
    async with view_client(ready["url"]) as client:
        await client.until(lambda: client.channels)
        await client.subscribe(*client.channels)
        await client.until(lambda: client.messages)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "")
    assert json.loads(out)["error"]["kind"] == "interrupted"


def test_another_ros_that_was_dropped_is_named(
    file: Path,
    spawn: Callable[..., subprocess.Popen[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    library = tmp_path / "ros" / "lib" / "librcl.so"
    library.parent.mkdir(parents=True)
    library.touch()
    monkeypatch.setenv(
        "LD_LIBRARY_PATH", f"{library.parent}:{os.environ.get('LD_LIBRARY_PATH', '')}"
    )
    process = spawn("view", str(file), "--port", "0", "--json")
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["url"]
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert err == "robotctl: dropped another ROS from LD_LIBRARY_PATH\n"


def _maps_of_children(pid: int) -> str:
    """Return what the children of a process have mapped."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return "".join(Path(f"/proc/{child}/maps").read_text() for child in children)


def test_a_file_that_cannot_be_shown_is_refused(cli: Callable[..., Ran], tmp_path: Path) -> None:
    ran = cli("view", str(tmp_path / "missing.mcap"))
    assert ran.exit_code == 6
    assert "missing.mcap" in ran.err
    (tmp_path / "text.mcap").write_text("no recording")
    assert cli("view", str(tmp_path / "text.mcap")).exit_code == 6


def test_wrong_options_are_refused_at_once(cli: Callable[..., Ran]) -> None:
    ran = cli("view", "--port", "99999")
    assert ran.exit_code == 2
    assert "--port 99999" in ran.err


def test_without_the_extra_the_cure_is_told(
    cli: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view_process, "find_spec", lambda name: None)
    ran = cli("view")
    assert ran.exit_code == 4
    assert "pip install 'robotctl[view]'" in ran.err


def test_without_a_daemon_it_says_how_to_start_one(cli: Callable[..., Ran]) -> None:
    ran = cli("view")
    assert ran.exit_code == 3
    assert "robotctl start" in ran.err
