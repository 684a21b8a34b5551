"""The loads under which the robot is stopped: each is a process beside the daemon."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from recording import publisher
from stopping import connections, flood

RECORDED_HZ = 1000.0
RECORDED_BYTES = 724
CALLS_HZ = 1000.0
CONNECTIONS = 1000
END_S = 60.0

TOLD = {
    "per_second": "messages/s",
    "calls": "calls/s",
    "answers": "answers/s",
    "connections": "connections",
    "opened": "opened again/s",
}
"""The keys of a load's report, and their units in the output."""


@dataclass(frozen=True)
class Bench:
    """`library` is the publisher in C++, "" without a compiler; `socket` is the daemon's."""

    library: str
    socket: str
    environment: Mapping[str, str]
    offered: dict[str, list[float]]
    """The rates that the loads really reached, by unit; one value per round."""


@contextmanager
def idle(_: Bench) -> Iterator[None]:
    yield


@contextmanager
def recorded(bench: Bench) -> Iterator[None]:
    """Publish odometry on another topic, which the daemon records."""
    arguments = [bench.library, "/load", "odometry", RECORDED_BYTES, RECORDED_HZ]
    with _running(bench, publisher.__file__, *arguments, announces=False):
        yield


@contextmanager
def flooded(bench: Bench) -> Iterator[None]:
    with _running(bench, flood.__file__, CALLS_HZ):
        yield


@contextmanager
def connected(bench: Bench) -> Iterator[None]:
    with _running(bench, connections.__file__, bench.socket, CONNECTIONS):
        yield


SITUATIONS: dict[str, Callable[[Bench], AbstractContextManager[None]]] = {
    "idle": idle,
    "recorded": recorded,
    "flooded": flooded,
    "connected": connected,
}


@contextmanager
def _running(
    bench: Bench, script: str, *arguments: object, announces: bool = True
) -> Iterator[None]:
    """Run a load during the block; its report, a line of JSON, is added to `bench.offered`."""
    process = subprocess.Popen(
        [sys.executable, script, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=dict(bench.environment),
    )
    assert process.stdout is not None
    try:
        if announces and process.stdout.readline() != "ready\n":
            raise SystemExit(f"{Path(script).name} did not start")
        yield
        said = json.loads(process.communicate(timeout=END_S)[0])
        for name in TOLD.keys() & said.keys():
            bench.offered.setdefault(TOLD[name], []).append(said[name])
    finally:
        process.kill()
        process.wait()
