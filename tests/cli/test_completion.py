"""The Tab key completes commands, options and names in bash, zsh and fish."""

from __future__ import annotations

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from robotctl.cli import registry
from robotctl.cli.completion import value_lists
from robotctl.cli.completion.candidates import candidates
from robotctl.cli.completion.installation import BEGIN, with_script
from robotctl.cli.completion.scripts import Shell

Cli = Callable[..., Any]

ROOT: Any = typer.main.get_command(registry.app)


DEADLINE_S = 60.0


def read_until(terminal: int, wanted: bytes) -> None:
    """Read from a pseudo-terminal until it shows `wanted`."""
    seen, end_s = b"", time.monotonic() + DEADLINE_S
    while wanted not in seen:
        ready, _, _ = select.select([terminal], [], [], end_s - time.monotonic())
        assert ready, seen
        seen += os.read(terminal, 4096)


def words(line: str) -> list[str]:
    return [each.word for each in candidates(ROOT, line.split(" "))]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("stat", ["status"]),
        ("set-mode ", ["emergency-stop", "error", "idle", "moving"]),
        ("set-mode m", ["moving"]),
        ("drive sq", ["square"]),
        ("drive square --si", ["--side"]),
        ("drive path points.csv --frame ", ["odom", "start"]),
        ("drive path points.csv --frame=o", ["--frame=odom"]),
        ("drive path points.csv --frame = o", ["odom"]),
        ("recordings r", ["rm"]),
        ("--json --robot r2 stat", ["status"]),
        ("completion install z", ["zsh"]),
        ("status --j", ["--json"]),
        ("no-such-command ", []),
        ("status x y ", []),
        ("drive path ", []),
    ],
)
def test_the_last_word_is_completed(line: str, found: list[str]) -> None:
    assert words(line) == found or (line == "no-such-command " and "status" in words(line))


def test_every_command_has_a_meaning() -> None:
    every = candidates(ROOT, [""])
    assert {each.word for each in every} == set(registry.COMMANDS)
    assert all(each.meaning for each in every)


def test_robots_and_recordings_are_found_by_name(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("robotctl.cli.support.robots.names", lambda: ["r1", "r2", "$(reboot)"])
    assert words("status --robot ") == ["r1", "r2"]
    assert words("status --robot=r2") == ["--robot=r2"]
    name = "robot_20260101_120000"
    (tmp_path / "cwd" / "recordings" / name).mkdir(parents=True)
    assert words("info ") == ["last", name]
    assert words("recordings keep ro") == [name]


def test_topics_and_parameters_are_those_of_the_daemon(cli: Cli, monkeypatch: Any) -> None:
    asked = []

    class Fake:
        def __init__(self, robot: str) -> None:
            asked.append(robot)

        def __enter__(self) -> Fake:
            return self

        def __exit__(self, *_: object) -> None: ...

        def call(self, method: str, deadline_s: float) -> Any:
            return {
                "graph": {"topics": [{"name": "/odom"}, {"name": "/a b"}, {"name": "/scan;ls"}]},
                "param_list": {"parameters": [{"key": "limits.linear_mps"}]},
            }[method]

    monkeypatch.setattr(value_lists, "Client", Fake)
    assert words("topic echo --robot r3 /") == ["/odom"]
    assert words("param get lim") == ["limits.linear_mps"]
    assert asked == ["r3", "robot"]


def test_without_a_daemon_there_is_no_topic_and_no_error(cli: Cli) -> None:
    ran = cli("completion", "words", "--", "topic", "echo", "/")
    assert (ran.exit_code, ran.out, ran.err) == (0, "", "")


def test_the_script_stands_once_in_the_start_file(
    tmp_path: Path, cli: Cli, monkeypatch: Any
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    (home / ".bashrc").write_text("alias x=y")
    for _ in range(2):
        assert cli("completion", "install", "bash").exit_code == 0
    text = (home / ".bashrc").read_text()
    assert text.startswith(f"alias x=y\n{BEGIN}")
    assert text.count(BEGIN) == 1
    assert with_script(f"{text}# mine\n", "new\n").endswith("end\n# mine\n")


@pytest.fixture
def path_with_robotctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / "robotctl").symlink_to(Path(sys.executable).with_name("robotctl"))
    monkeypatch.setenv("PATH", str(tools), prepend=os.pathsep)
    monkeypatch.setenv("HOME", str(tmp_path))


def shell(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


@pytest.mark.usefixtures("path_with_robotctl")
def test_bash_completes() -> None:
    asked = "COMP_WORDS=(robotctl set-mode mo); COMP_CWORD=2; _robotctl robotctl mo set-mode"
    script = f"{Shell.BASH.script}\n{asked}\necho ${{COMPREPLY[@]}}; complete -p robotctl"
    command = [shell("bash"), "--norc", "-c", script]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.stdout.splitlines() == ["moving", "complete -o default -F _robotctl robotctl"]


@pytest.mark.usefixtures("path_with_robotctl")
def test_fish_completes() -> None:
    script = f"{Shell.FISH.script}\ncomplete -C 'robotctl set-mode mo'; complete -C 'robotctl stat'"
    command = [shell("fish"), "--no-config", "-c", script]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    first, second = ran.stdout.splitlines()
    assert (first, second.split("\t")[0]) == ("moving", "status")


@pytest.mark.usefixtures("path_with_robotctl")
def test_zsh_completes(tmp_path: Path) -> None:
    program = shell("zsh")
    (tmp_path / "script.zsh").write_text(Shell.ZSH.script)
    ours, theirs = pty.openpty()
    started = subprocess.Popen(
        [program, "-f", "-i"], stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    )
    os.close(theirs)
    try:
        os.write(ours, f"PS1='> '; source {tmp_path}/script.zsh && echo rea''dy\n".encode())
        read_until(ours, b"ready")
        os.write(ours, b"robotctl set-mode mo\t")
        read_until(ours, b"moving")
    finally:
        started.kill()
        started.wait()
        os.close(ours)
