"""The real daemon through the real command line, each test in a separate world."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

import tests.support.rosidl_parser  # noqa: F401
from robotctl.base.errors import NoDaemon
from robotctl.daemon.command_line import DaemonOptions
from robotctl.ipc.client import call
from robotctl.recording import RecorderState, RecorderStats, TopicStats
from robotctl.recording.format.topics import total
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import Peer, World, new_world, world_with_daemon


@pytest.fixture
def world() -> Iterator[World]:
    """A world for one test."""
    with new_world() as made:
        yield made


@pytest.fixture(scope="module")
def simulated() -> Iterator[World]:
    """A world with one daemon, which simulates its robot, for the tests of a module."""
    with world_with_daemon() as made:
        until(lambda: made.here("preflight").exit_code == 0)
        yield made


@pytest.fixture
def new_peer() -> Iterator[Callable[[World], Peer]]:
    """Return a function that starts another ROS process in a world."""
    with ExitStack() as stack:

        def make(world: World) -> Peer:
            peer = Peer(world)
            stack.callback(peer.close)
            return peer

        yield make


class Daemon:
    """A daemon in this process and loop; requests go through its socket."""

    def __init__(self, started: Any) -> None:
        self.started = started

    async def ask(self, method: str, **params: Any) -> Any:
        """Call a method of the control socket from another thread."""
        return await asyncio.to_thread(call, "robot", method, params)

    async def until(self, condition: Callable[[Any], object]) -> Any:
        """Wait until the status fulfils a condition; return that status."""
        async with asyncio.timeout(DEADLINE_S):
            while True:
                with suppress(NoDaemon):  # a test may kill the task that answers
                    status = await self.ask("status")
                    if condition(status):
                        return status
                await asyncio.sleep(0.02)


def stats_of(*topics: TopicStats, failure: str = "") -> RecorderStats:
    """Return the counts of a recorder with these topics."""
    return RecorderStats(
        state=RecorderState.FAILED if failure else RecorderState.RECORDING,
        file=Path("/data/run_0.mcap"),
        bytes=1,
        **total(topics),
        no_memory=0,
        failure=failure,
        warning="",
        topics=topics,
    )


def is_moving(status: Any) -> bool:
    return bool(status["mode"] == "MOVING" and status["velocity"]["linear"] > 0.02)


@pytest.fixture
def in_process(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., AbstractAsyncContextManager[Daemon]]:
    """Run a daemon in the test's loop with the given options; its limits are wide by default."""
    world.enter(monkeypatch)

    @asynccontextmanager
    async def run(**options: Any) -> AsyncIterator[Daemon]:
        from robotctl.daemon.app import serve

        ready: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        chosen: dict[str, Any] = {"config": world.patient, "drive": None, "sim": True, **options}
        text = chosen["config"].read_text() if chosen["config"] else ""
        if "recording.index" not in text:  # its process may outlive the test
            chosen["config"] = world.folder / "in_process.yaml"
            chosen["config"].write_text(f"{text}recording.index: false\n")
        given = DaemonOptions(
            "robot", recordings=world.recordings, domain_id=world.domain_id, **chosen
        )
        with ExitStack() as at_end:
            serving = asyncio.create_task(serve(given, [], ready.set_result, at_end))
            await asyncio.wait({serving, ready}, return_when=asyncio.FIRST_COMPLETED)
            if serving.done():
                await serving  # raises the reason of a failed start
            try:
                yield Daemon(ready.result())
            except BaseException:
                serving.cancel()
                raise
            else:
                os.kill(os.getpid(), signal.SIGTERM)
            finally:
                await asyncio.wait({serving})
            await serving

    return run
