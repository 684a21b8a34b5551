"""docs/architecture.md shows the mode table and the exit codes as the code has them."""

from __future__ import annotations

import re
import runpy
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
