"""A Dask scheduler and workers on this machine, each a process; none outlives its test.

They are forked from one process that has imported Dask and the gate already: that takes a second.
"""

from __future__ import annotations

import asyncio
import ctypes
import logging
import os
import signal
import tempfile
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager

from distributed import Scheduler, Worker

import robotctl.collection.gate  # noqa: F401 - what workers import for their first job
from tests.support.lines import Told, obey, peer_command

_PR_SET_PDEATHSIG = 1

QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false"}
"""Without the profile that each worker takes of itself, as docs/fleet.md advises."""

Server = Scheduler | Worker


class _Forker:
    """The process that forks the others; they are killed with it."""

    def __init__(self, scratch: str) -> None:
        self._scratch = scratch
        self._pids: set[int] = set()

    def scheduler(self, port: int) -> list[int | str]:
        """Start a scheduler; return its pid and address."""

        async def begin() -> Server:
            server: Scheduler = await Scheduler(
                host="127.0.0.1", port=port, dashboard=False, dashboard_address=":0"
            )
            return server

        return self._fork(begin)

    def worker(self, scheduler: str) -> list[int | str]:
        """Start a worker with one thread; return its pid and address."""

        async def begin() -> Server:
            server: Worker = await Worker(
                scheduler, nthreads=1, dashboard=False, local_directory=self._scratch
            )
            return server

        return self._fork(begin)

    def kill(self, pid: int) -> None:
        """Kill one of them as the kernel kills what takes too much memory."""
        self._pids.remove(pid)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)

    def kill_all(self) -> None:
        """Kill all that are left."""
        for pid in tuple(self._pids):
            self.kill(pid)

    def _fork(self, begin: Callable[[], Awaitable[Server]]) -> list[int | str]:
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            try:
                os.close(reading)
                _die_with_parent()
                os.dup2(os.open(os.devnull, os.O_RDWR), 0)  # the lines of the test are not its own
                os.dup2(0, 1)
                asyncio.run(_serve(begin, writing))
            finally:
                os._exit(1)
        self._pids.add(pid)
        os.close(writing)
        with open(reading, encoding="ascii") as file:
            address = file.read()
        assert address, "it did not start"
        return [pid, address]


async def _serve(begin: Callable[[], Awaitable[Server]], writing: int) -> None:
    server = await begin()
    os.write(writing, server.address.encode())
    os.close(writing)
    await server.finished()  # type: ignore[no-untyped-call]


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class DaskProcesses:
    """The scheduler and workers of a test."""

    def __init__(self, told: Told, workers: int) -> None:
        """Start them."""
        self._told = told
        self._count = workers
        self._scheduler, self.address = told("scheduler", port=0)
        self._workers = [told("worker", scheduler=self.address)[0] for _ in range(workers)]

    def kill_worker(self) -> None:
        """Kill the worker that was started first."""
        self._told("kill", pid=self._workers.pop(0))

    def kill_scheduler(self) -> None:
        """Kill the scheduler; its workers end when they notice."""
        self._told("kill", pid=self._scheduler)

    def restart(self) -> None:
        """Start the scheduler at the same address again, with workers, as a supervisor does."""
        port = int(self.address.rpartition(":")[2])
        self._scheduler, _ = self._told("scheduler", port=port)
        self._workers = [
            self._told("worker", scheduler=self.address)[0] for _ in range(self._count)
        ]


@contextmanager
def dask_processes(workers: int = 3) -> Iterator[DaskProcesses]:
    """Yield a scheduler with workers, connected over TCP; kill all at the end."""
    with Told(peer_command("tests.collection.dask_processes"), os.environ | QUIET) as told:
        yield DaskProcesses(told, workers)


def _main() -> None:
    logging.disable(logging.CRITICAL)  # tests kill their peers
    with tempfile.TemporaryDirectory() as scratch:
        forker = _Forker(scratch)
        try:
            obey(forker)
        finally:
            forker.kill_all()


if __name__ == "__main__":
    _main()
