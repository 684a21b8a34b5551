"""Every error ends in one sentence and its exit code, without a traceback."""

from __future__ import annotations

import errno
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import robotctl
from robotctl.base.errors import NoDaemon
from robotctl.cli import quick, registry
from robotctl.cli.registry import COMMANDS as OURS
from tests.cli.conftest import Cli
from tests.support.lines import Ran, run_program
from tests.support.recordings import recorded

COMMANDS = [
    *(*OURS, "record status", "record split"),
    *("recordings keep", "recordings unkeep", "recordings rm"),
]

WITHOUT_A_DAEMON = [
    *("status", "set-mode idle", "estop", "reset", "stop", "drive square", "mark here"),
    *("record status", "record split"),
]
NO_DAEMON = "robotctl: no daemon for robot 'robot' (start one with: robotctl start)\n"


@pytest.mark.parametrize("arguments", [*WITHOUT_A_DAEMON, "watch", "view"])
def test_without_a_daemon_every_command_says_how_to_start_one(arguments: str, cli: Cli) -> None:
    ran = cli(*arguments.split())
    assert (ran.exit_code, ran.out, ran.err) == (3, "", NO_DAEMON)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ("set-mode flying", f"no mode 'flying': use {quick.VALID_MODES}"),
        ("set-mode 255", f"no mode '255': use {quick.VALID_MODES}"),
        ("status --robot ../etc", "robot name '../etc': use a letter"),
        ("stat", "No such command 'stat'. Did you mean 'start', 'status'?"),
        ("drive", "Missing argument 'PATTERN'. Choose from: square, circle, figure-eight"),
        ("drive star", "'star' is not one of square, circle, figure-eight"),
        ("drive square --radius 2", "a square has no --radius: use --side"),
        ("drive circle --side 2", "a circle has no --side: use --radius"),
        ("drive square --laps -1", "--laps -1: use 0 to 100000"),
        ("drive path", "a path needs a FILE"),
        ("drive path none.csv", "no file none.csv"),
        ("drive square none.csv", "a square has no file: use robotctl drive path FILE"),
        ("drive square --frame odom", "a square has no --frame: it is for the path of a file"),
        ("drive path --topic plan --frame odom", "a path of a topic has no --frame"),
        ("drive velocity 0.2", "a velocity is two numbers"),
        ("drive velocity 0.2 -0.5", "a velocity needs --for: use 0.02 to 600 s"),
        ("drive velocity 0.2 -0.5 --for 2h", "--for 2h: use 0.02 to 600 s"),
        ("drive velocity 0.2 0 --for 2 --laps 2", "a velocity has no --laps"),
        ("drive turn --side 2", "a turn has no --side"),
        ("drive line --angle 20", "a line has no --angle: it is for an arc or a turn"),
        (
            "drive square --corner 0.1",
            "a square has no --corner: it is for a rounded-square or a path",
        ),
        ("drive turn --angle 0.5", "--angle 0.5: use 0.58 to 5729 degrees"),
        ("drive line --for 2s", "a line has no --for: it is for a velocity"),
        ("drive --sped 0.3 square", "No such option: --sped"),
        ("drive velocity nan 0 --for 2s", "a velocity is two numbers"),
        ("drive velocity 0.2 -inf --for 2s", "a velocity is two numbers"),
        ("drive square --side 0", "--side 0: use 0.1 to 100 m"),
        ("drive circle --radius nan", "--radius nan: use 0.1 to 100 m"),
        ("drive square --speed 11", "--speed 11: use 0.01 to 10 m/s"),
        ("set-mode", "Missing argument 'MODE' (see: robotctl set-mode --help)"),
        ("--bogus", "No such option: --bogus (see: robotctl --help)"),
    ],
)
def test_a_usage_error_is_a_sentence_and_exit_code_2(arguments: str, text: str, cli: Cli) -> None:
    assert cli(*arguments.split()).refused(2, text).startswith("robotctl: ")


WITH_JSON = [
    *WITHOUT_A_DAEMON,
    *("start", "drive square --wait", "info nowhere", "clip nowhere", "recover nowhere"),
    *("why nowhere", "replay nowhere", "replay nowhere --check"),
    "replay nowhere --what-if tracking.k_y=8",
]
"""Command lines that fail without a daemon."""


@pytest.mark.parametrize("arguments", WITH_JSON)
def test_a_failure_with_json_is_one_object_on_stdout(
    arguments: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_START", "run-already")
    ran = cli(*arguments.split(), "--json")
    (line,) = ran.out.splitlines()
    error = json.loads(line)["error"]
    assert set(error) == {"kind", "message", "cause", "cure", "exit_code"}
    assert ran.exit_code == error["exit_code"] != 0
    assert ran.err.endswith(f"robotctl: {error['message']}\n")
    assert error["cause"] in error["message"]


def test_the_object_of_a_failure_separates_cause_and_cure(cli: Cli) -> None:
    error = cli("status", "--robot", "r2", "--json").summary["error"]
    assert error == {
        "kind": "no_daemon",
        "message": NO_DAEMON.removeprefix("robotctl: ").strip().replace("'robot'", "'r2'")[:-1]
        + " --robot r2)",
        "cause": "no daemon for robot 'r2'",
        "cure": "start one with: robotctl start --robot r2",
        "exit_code": 3,
    }


def test_a_bug_and_ctrl_c_are_told_in_json_too(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    for raised, kind, exit_code in (
        (ZeroDivisionError("a bug"), "internal", 1),
        (KeyboardInterrupt(), "interrupted", 130),
        (PermissionError(errno.EACCES, "Permission denied", "/root/x"), "internal", 1),
    ):

        def fail(*_: object, raised: BaseException = raised) -> None:
            raise raised

        monkeypatch.setattr(quick, "call", fail)
        ran = cli("status", "--json")
        assert ran.exit_code == exit_code
        error = ran.summary["error"]
        assert (error["kind"], error["exit_code"]) == (kind, exit_code)
        assert error["message"]


def record_cut_short(folder: Path) -> Path:
    """Record 100 messages, and cut off the end of the file."""
    file = recorded(folder / "run", 100)
    file.write_bytes(file.read_bytes()[:-30])
    return file


def test_what_was_found_stands_in_the_object_beside_the_error(cli: Cli, tmp_path: Path) -> None:
    file = record_cut_short(tmp_path)
    for command in ("info", "recover"):
        ran = cli(command, str(file), "--json")
        assert ran.summary["messages"] == 100
        assert ran.summary["error"]["exit_code"] == ran.exit_code != 0


@pytest.mark.parametrize(
    ("raised", "told"),
    [
        (
            ZeroDivisionError("a bug"),
            "unexpected ZeroDivisionError: a bug (see where with: robotctl --debug ...)",
        ),
        (
            PermissionError(errno.EACCES, "Permission denied", "/root/x"),
            "/root/x: Permission denied",
        ),
    ],
)
def test_a_bug_and_an_error_of_the_file_system_are_one_sentence(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, raised: Exception, told: str
) -> None:
    def fail(*_: object) -> None:
        raise raised

    monkeypatch.setattr(quick, "call", fail)
    ran = cli("status")
    assert (ran.exit_code, ran.err) == (1, f"robotctl: {told}\n")


@pytest.mark.parametrize("arguments", [["--debug", "status"], ["status", "--debug"]])
def test_debug_shows_the_traceback(arguments: list[str], cli: Cli) -> None:
    with pytest.raises(NoDaemon):
        cli(*arguments)


def test_an_error_cannot_steer_the_terminal(cli: Cli) -> None:
    err = cli("set-mode", "\x1b[2J\n\u202e").failed(2)
    assert err.isascii()
    assert err.removesuffix("\n").isprintable()


def test_a_closed_pipe_is_no_error(daemon: None, command: list[str]) -> None:
    for arguments in (["status"], ["logs"]):
        reading, writing = os.pipe()
        os.close(reading)
        ran = subprocess.run([*command, *arguments], stdout=writing, stderr=subprocess.PIPE)
        os.close(writing)
        assert (ran.returncode, ran.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("arguments", "exit_code", "closed"),
    [
        ("--help", 0, ">&-"),
        ("status", 3, ">&-"),
        ("status", 3, "2>&-"),
        ("recordings", 0, ">&- 2>&-"),
    ],
)
def test_a_command_does_its_work_with_its_output_closed(
    command: list[str], arguments: str, exit_code: int, closed: str
) -> None:
    line = f"{shlex.join([*command, arguments])} {closed}"
    ran = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
    assert ran.returncode == exit_code
    assert "unexpected" not in ran.stderr
    assert "robotctl: no daemon" not in ran.stdout


@pytest.mark.parametrize(("name", "options"), [("cut", []), ("cut", ["--json"]), ("nothing", [])])
def test_the_exit_code_is_that_of_the_error_even_if_stdout_is_closed(
    command: list[str], tmp_path: Path, name: str, options: list[str]
) -> None:
    file = str(record_cut_short(tmp_path)) if name == "cut" else name
    reading, writing = os.pipe()
    os.close(reading)
    program = [*command, "info", file, *options]
    ran = subprocess.run(program, stdout=writing, stderr=writing, check=False)
    os.close(writing)
    assert ran.returncode == 6


def test_output_to_a_full_disk_is_one_sentence(daemon: None, command: list[str]) -> None:
    for arguments in (["status"], ["recordings"]):
        with open("/dev/full", "w") as full:
            ran = subprocess.run(
                [*command, *arguments], stdout=full, stderr=subprocess.PIPE, text=True, check=False
            )
        told = "robotctl: no space left on the disk for the output: free some\n"
        assert (ran.returncode, ran.stderr) == (1, told)


def test_a_user_without_a_home_reads_what_to_set(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(_: type[Path]) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr(Path, "home", classmethod(unknown))
    err = cli("logs").refused(2)
    assert err == ("robotctl: you have no home folder: set XDG_STATE_HOME to a folder\n")


INTERRUPTED_IMPORT = """
import sys
from robotctl.cli import app

class CtrlC:
    def find_spec(self, name, *_):
        if name == "robotctl.cli.quick":
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
app.main()
"""


def test_ctrl_c_while_libraries_are_imported_shows_no_traceback() -> None:
    program = [sys.executable, "-c", INTERRUPTED_IMPORT, "status"]
    assert run_program(*program) == Ran(130, "", "")


def test_the_version_is_the_packages(cli: Cli) -> None:
    assert cli("--version").out == f"robotctl {robotctl.__version__}\n"


def test_nothing_at_all_shows_the_help(cli: Cli) -> None:
    out = cli().succeeded()
    assert out == cli("--help").out
    assert all(f"\n  {name} " in out for name in OURS)


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_every_help_fits_80_columns(name: str, cli: Cli) -> None:
    out = cli(*name.split(), "--help").succeeded()
    assert max(len(line) for line in out.splitlines()) <= 80


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_in_the_help_can_be_typed(name: str) -> None:
    app: Any = get_command(registry.app)
    context = app.make_context("robotctl", [], resilient_parsing=True)
    command = app
    for word in name.split():
        command = command.get_command(context, word)
    _, _, examples = command.help.partition("Examples:\n")
    assert examples
    for line in examples.splitlines():
        words = shlex.split(line.partition("|")[0].partition("--ros-args")[0])[1:]
        assert words[: len(name.split())] == name.split()
        app.get_command(context, words[0]).make_context(words[0], words[1:])


def test_output_that_the_terminal_cannot_encode_is_escaped(
    daemon: None, command: list[str], tmp_path: Path
) -> None:
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ran = subprocess.run([*command, "status"], capture_output=True, env=environment)
    assert ran.returncode == 0
    assert ran.stdout.isascii()
