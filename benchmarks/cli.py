"""Wall time of the commands that scripts and people in a hurry run, next to an empty Python.

    python benchmarks/cli.py                            about 20 seconds
    python benchmarks/cli.py --rounds 40

A daemon of a standing robot answers `robotctl status` and `robotctl set-mode idle`. Each round runs
`python -c pass` and both commands in the same environment, that of a shell: without the variables
that the ROS wheels set for children of a Python process. Ratios are computed within a round. Shown
are medians over the rounds, and the lowest and highest in brackets.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

ROBOTCTL = Path(sys.executable).with_name("robotctl")
RATIO_TARGET, TIME_TARGET_S = 2.7, 0.15
ROS2_SERVICE_CALL_S = 0.98
"""Measured elsewhere; there is no ros2cli on this platform."""

FREE_DOMAINS = (101, 230)
EMPTY = "python -c pass"
COMMANDS = {
    EMPTY: [sys.executable, "-c", "pass"],
    "robotctl status": [str(ROBOTCTL), "status"],
    "robotctl set-mode idle": [str(ROBOTCTL), "set-mode", "idle"],
}


def shell_environment(folder: str) -> dict[str, str]:
    """Return the environment of a command in a shell, with sockets and logs in `folder`."""
    first_domain, last_domain = FREE_DOMAINS
    inherited = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH")
    environment = {name: value for name, value in os.environ.items() if name not in inherited}
    return {
        **environment,
        "ROS_DOMAIN_ID": str(first_domain + os.getpid() % (last_domain - first_domain)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_RUNTIME_DIR": folder,
        "XDG_STATE_HOME": folder,
    }


@contextmanager
def daemon(environment: Mapping[str, str], folder: str) -> Iterator[None]:
    """Start a daemon that answers the commands, and stop it at the end of the block."""
    start = [str(ROBOTCTL), "start", "--sim", "--recordings", folder]
    subprocess.run(start, env=environment, check=True, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        stop = [str(ROBOTCTL), "stop"]
        subprocess.run(stop, env=environment, check=True, stdout=subprocess.DEVNULL)


def wall_s(command: Sequence[str], environment: Mapping[str, str]) -> float:
    """Run a command; return its wall time [s]."""
    begun = time.perf_counter()
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begun


def spread(values: Sequence[float], digits: str) -> str:
    """Return `MEDIAN [LOWEST .. HIGHEST]` as text."""
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:{digits}} [{low:{digits}} .. {high:{digits}}]"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=25)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        environment = shell_environment(folder)
        with daemon(environment, folder):
            for command in COMMANDS.values():
                wall_s(command, environment)  # what was never read is read from the disk
            rounds = [
                {name: wall_s(command, environment) for name, command in COMMANDS.items()}
                for _ in range(options.rounds)
            ]
    reached = True
    for name in COMMANDS:
        times = [results[name] for results in rounds]
        line = f"{name:23} {spread([1000 * each for each in times], '5.1f')} ms"
        if name != EMPTY:
            ratios = [results[name] / results[EMPTY] for results in rounds]
            ok = (
                statistics.median(ratios) <= RATIO_TARGET
                and statistics.median(times) < TIME_TARGET_S
            )
            reached = reached and ok
            line += f"   {spread(ratios, '.2f')} times an empty Python: "
            line += "reached" if ok else "NOT REACHED"
        print(line)
    print(
        f"To be at most {RATIO_TARGET} times an empty Python, under {1000 * TIME_TARGET_S:g} ms;"
        f" `ros2 service call` takes {1000 * ROS2_SERVICE_CALL_S:g} ms (measured elsewhere)."
    )
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
