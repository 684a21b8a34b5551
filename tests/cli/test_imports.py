"""Quick commands import no library that they do not need."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {"rclpy", "rich", "msgspec", "pydantic", "numpy", "mcap", "yaml", "asyncio"}

PROGRAM = """
import sys
from robotctl.cli.app import run
before = set(sys.modules)
assert run(sys.argv[1:]) == 0
print("imported", *{module.partition(".")[0] for module in sys.modules})
"""


def imported_by(*arguments: str) -> set[str]:
    """Return the top-level modules that a command line imports in a new interpreter."""
    program = [sys.executable, "-c", PROGRAM, *arguments]
    ran = subprocess.run(program, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return set(ran.stdout.splitlines()[-1].split()[1:])


def test_help_imports_no_heavy_library() -> None:
    assert not imported_by("--help") & HEAVY


@pytest.mark.parametrize(
    "arguments", [["status"], ["set-mode", "moving"], ["estop"], ["reset"], ["stop", "--json"]]
)
def test_what_controls_the_robot_imports_not_even_typer(arguments: list[str], daemon: None) -> None:
    assert not imported_by(*arguments) & (HEAVY | {"typer", "dataclasses", "inspect"})


@pytest.mark.parametrize("arguments", [["status", "--help"], ["drive", "square"]])
def test_other_commands_import_no_heavy_library(arguments: list[str], daemon: None) -> None:
    assert not imported_by(*arguments) & (HEAVY - {"pydantic"})


STARTS = """
import sys
from robotctl.cli import app
app._parse_and_run = lambda _: print("imported", *sys.modules)
assert app.run(sys.argv[1:]) == 0
"""


def test_a_path_of_this_computer_needs_no_store() -> None:
    program = "import sys; from robotctl.cli.targets.recordings import recording_path as path"
    program += "; path('run.mcap'); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert b"robotctl.base.store.remote_file" in ran.stdout
    assert b"robotctl.base.store.folder_store" not in ran.stdout
