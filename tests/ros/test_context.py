"""A process joins a ROS domain, creates no files in the user's home, and leaves the domain."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

OPENS = """
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
        [sys.executable, "-c", OPENS],
        env=environment | homes[home],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ran.returncode, ran.stdout) == (0, "True\n"), ran.stderr
    assert not list(tmp_path.iterdir())


HANGS_AT_THE_END = """
import asyncio, ctypes, sys
from contextlib import ExitStack
from rclpy.context import Context
from robotctl.ros import context
from robotctl.ros.session import ros_session

def hang(_):
    ctypes.PyDLL(None).pause()  # as Fast DDS does: in C, with the GIL

async def main(at_end):
    domain_id = int(sys.argv[1])
    async with ros_session(domain_id=domain_id, namespace="", at_end=at_end) as session:
        session.node("hanging")
        session.last.callback(print, "kept", flush=True)

Context.destroy = hang
context.END_S = 0.1
with ExitStack() as at_end:
    asyncio.run(main(at_end))
    print("told", flush=True)
"""


def test_a_process_ends_though_the_middleware_does_not_let_go_of_it(domain_id: int) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", HANGS_AT_THE_END, str(domain_id)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ran.returncode, ran.stdout) == (1, "kept\ntold\n")
    assert "in close_context" in ran.stderr
