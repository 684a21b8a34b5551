"""The program of docs/fleet.md that runs the gate on Ray, where Ray is installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from robotctl.testing.drives import drive, record

pytest.importorskip("ray", reason="Ray has 240 MB: no extra brings it")

PAGE = Path(__file__).parents[2] / "docs/fleet.md"


def test_the_gate_runs_on_ray(tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(import sys\n.*?)```", PAGE.read_text(), re.DOTALL)
    for name in ("one", "two"):
        record(tmp_path / name, drive(1.0))
    ran = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)],
        env=os.environ | {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert "'same': 2" in ran.stdout
    assert len(list((tmp_path / ".gate").iterdir())) == 2
