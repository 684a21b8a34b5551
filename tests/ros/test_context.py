"""A process that takes part in ROS leaves nothing of it in the user's home."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
from robotctl.ros.context import open_context
context = open_context(0)
print(context.ok())
context.try_shutdown()
"""


@pytest.mark.parametrize("home", ["empty", "read-only", "unknown"])
def test_a_context_opens_and_writes_no_log_file(home: str, tmp_path: Path) -> None:
    homes = {"empty": {"HOME": str(tmp_path)}, "read-only": {"HOME": "/proc"}, "unknown": {}}
    elsewhere = ("HOME", "ROS_HOME", "ROS_LOG_DIR")
    environment = {name: value for name, value in os.environ.items() if name not in elsewhere}
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=environment | homes[home],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ran.returncode, ran.stdout) == (0, "True\n"), ran.stderr
    assert not list(tmp_path.iterdir())
