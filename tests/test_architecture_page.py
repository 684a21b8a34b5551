"""docs/architecture.md shows the mode table and the exit codes as the code has them."""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

from robotctl import errors

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "architecture.md"


def test_the_mode_diagram_is_drawn_from_the_table() -> None:
    drawn = runpy.run_path(str(ROOT / "docs" / "mode_diagram.py"))["mermaid"]()
    assert drawn.startswith("stateDiagram-v2\n")
    shown = PAGE.read_text(encoding="utf-8")
    assert f"```mermaid\n{drawn}\n```\n" in shown, "paste: python docs/mode_diagram.py"


def test_the_page_names_every_exit_code() -> None:
    codes = {
        kind.exit_code
        for kind in vars(errors).values()
        if isinstance(kind, type) and issubclass(kind, errors.RobotctlError)
    }
    text = PAGE.read_text(encoding="utf-8").split("## Exit codes", 1)[1]
    named = {int(number) for number in re.findall(r"\b(\d+) [a-z]", text)}
    assert named == codes | {0, errors.INTERRUPTED_EXIT_CODE}


def thread_names(path: Path) -> Iterator[str]:
    """Yield the name of each thread that the file creates."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Thread", "threading.Thread"):
            names = [each.value for each in node.keywords if each.arg == "name"]
            assert names, f"{path}: a thread without a name"
            yield str(ast.literal_eval(names[0]))


def test_the_page_lists_every_thread_that_a_daemon_creates() -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Threads and processes", 1)[1]
    page = section.split("\n## ", 1)[0]
    files = [
        path
        for part in ("daemon", "ros", "recording/write")
        for path in (ROOT / "robotctl" / part).rglob("*.py")
    ]
    names = {name for path in files for name in thread_names(path)}
    assert {"watchdog", "latch", "recorder"} <= names
    assert {name for name in names if f"`{name}`" not in page} == set()
