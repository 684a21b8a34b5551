"""The scripts of benchmarks/ can be started; mypy checks what they call."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from tests.support.lines import run_program

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SCRIPTS = sorted(BENCHMARKS.glob("*.py"))

HELP_OF_EACH = """
import contextlib, io, runpy, sys

for script in sys.argv[1:]:
    sys.argv = [script, "--help"]
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as shown:
        runpy.run_path(script, run_name="__main__")
    print(script, "shows its usage" if shown.getvalue().startswith("usage: ") else "does not")
"""
"""One process for all: most of the time is the imports, which the scripts share."""


def test_each_benchmark_script_shows_its_usage() -> None:
    pytest.importorskip("foxglove", reason="benchmarks/recorder.py needs the `dev` extra")
    ran = run_program(sys.executable, "-c", HELP_OF_EACH, *SCRIPTS, cwd=BENCHMARKS)
    assert ran.err == ""
    assert ran.out.splitlines() == [f"{script} shows its usage" for script in SCRIPTS]


def test_the_page_of_the_benchmarks_names_each_script() -> None:
    page = (BENCHMARKS / "README.md").read_text()

    assert [script for script in SCRIPTS if f"python benchmarks/{script.name}" not in page] == []


@pytest.mark.parametrize("moving", [True, False])
def test_the_drive_that_the_benchmarks_check_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, moving: bool
) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS)
    record_drive = importlib.import_module("recording.heard_drive").record_drive
    folder = record_drive(tmp_path / "drive", 2.0, rate_hz=50.0, moving=moving)

    report = check_recording(folder)

    assert (report.verdict, report.missing) == (Verdict.SAME, [])
