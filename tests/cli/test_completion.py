"""The Tab key completes commands, options and names in bash, zsh and fish."""

from __future__ import annotations

import os
import pty
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
import typer

from robotctl.cli import registry
from robotctl.cli.commands.completion import BEGIN, Shell, script, with_script
from tests.cli.conftest import Cli

ROOT: Any = typer.main.get_command(registry.app)


DEADLINE_S = 60.0


def read_until(terminal: int, wanted: bytes) -> None:
    """Read from a pseudo-terminal until it shows `wanted`."""
    seen, end_s = b"", time.monotonic() + DEADLINE_S
    while wanted not in seen:
        ready, _, _ = select.select([terminal], [], [], end_s - time.monotonic())
        assert ready, seen
        seen += os.read(terminal, 4096)


def test_what_an_installed_script_calls_offers_nothing_and_no_error(cli: Cli) -> None:
    ran = cli("completion", "words", "--", "topic", "echo", "--robot", "/")
    assert (ran.exit_code, ran.out, ran.err) == (0, "", "")


@pytest.mark.parametrize("shell", Shell)
def test_a_script_knows_every_command(cli: Cli, shell: Shell) -> None:
    shown = cli("completion", "show", shell.value).out
    for name in (*registry.COMMANDS, "emergency-stop", "figure-eight", "--what-if", "install"):
        assert f"{name} " in shown
    assert "completion words" not in shown, "it is static"


def test_the_script_is_once_in_the_start_file(tmp_path: Path, cli: Cli, monkeypatch: Any) -> None:
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


def shell(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def test_bash_completes() -> None:
    ask = """
ask() { COMP_WORDS=(robotctl "$@"); COMP_CWORD=$#; _robotctl; echo "${COMPREPLY[@]}"; }
ask set-mode mo; ask stat; ask recordings r; ask drive sq; ask drive square --si
ask --json --robot r2 stat; ask status --j; ask completion install z; ask replay none.mc
complete -p robotctl
"""
    command = [shell("bash"), "--norc", "-c", f"{script(Shell.BASH, ROOT)}\n{ask}"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.stdout.splitlines() == [
        *("moving", "status", "rm", "square", "--side", "status", "--json", "zsh", ""),
        "complete -o default -F _robotctl robotctl",
    ]


def test_fish_completes() -> None:
    ask = "complete -C 'robotctl set-mode mo'; complete -C 'robotctl stat'"
    command = [shell("fish"), "--no-config", "-c", f"{script(Shell.FISH, ROOT)}\n{ask}"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.stdout.splitlines() == ["moving", "status"]


def test_zsh_completes(tmp_path: Path) -> None:
    program = shell("zsh")
    (tmp_path / "script.zsh").write_text(script(Shell.ZSH, ROOT))
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
