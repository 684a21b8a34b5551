"""Replays in separate processes, received in this one, and daemons that only report their state."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

import tests.support.rosidl_parser  # noqa: F401
from robotctl.base.paths import make_private, runtime_folder, socket_path
from robotctl.ipc.method_params import NoParams
from robotctl.ipc.server import ControlServer, Identity, Method
from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.lines import Ran
from tests.support.waiting import DEADLINE_S


class Running:
    """A running `robotctl replay`."""

    def __init__(self, *arguments: str) -> None:
        program = "from robotctl.cli.app import main; main()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", program, "replay", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def interrupt(self) -> None:
        """Send Ctrl-C."""
        self._process.send_signal(signal.SIGINT)

    def stop_reading(self) -> None:
        """Stop reading its output, as a pager that was closed."""
        assert self._process.stdout is not None
        self._process.stdout.close()

    def kill(self) -> None:
        """Kill the command."""
        self._process.kill()

    def close(self) -> None:
        """End it if it is running."""
        if self._process.returncode is None:
            self._process.kill()
            self._process.communicate(timeout=2 * DEADLINE_S)

    async def end(self) -> Ran:
        """Wait for its end."""
        out, err = await asyncio.to_thread(self._process.communicate, timeout=2 * DEADLINE_S)
        return Ran(self._process.returncode, out, err)


Replay = Callable[..., Awaitable[Ran]]


@pytest.fixture
def start(domain_id: int, own_sockets: None) -> Iterator[Callable[..., Running]]:
    """Start a replay in the test's domain."""
    started: list[Running] = []

    def begin(*arguments: object) -> Running:
        started.append(Running(*map(str, arguments)))
        return started[-1]

    yield begin
    for each in started:
        each.close()


@pytest.fixture
def replay(start: Callable[..., Running]) -> Replay:
    """Run a replay in the test's domain."""

    async def carry_out(*arguments: object) -> Ran:
        return await start(*arguments).end()

    return carry_out


@pytest.fixture
def own_sockets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use control sockets of this test only."""
    base = Path(os.environ["XDG_RUNTIME_DIR"])
    folder = base / f"{len(list(base.iterdir()))}"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


class Listener:
    """Receives serialized messages in this process; `heard` has them by topic, in order."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self.heard: dict[str, list[bytes]] = {}

    def listen(self, topic: str, type_name: str, qos: Any = 1000) -> None:
        """Subscribe."""
        from robotctl.ros.message_types import message_class

        heard = self.heard.setdefault(topic, [])
        tap = RawTap(lambda data, *_: heard.append(data))
        self.node.create_subscription(message_class(type_name), topic, tap, qos, raw=True)


@pytest.fixture
async def listener(domain_id: int) -> AsyncIterator[Listener]:
    """A node in the domain of the replay, in another process."""
    from rclpy.context import Context
    from rclpy.node import Node

    context = Context()
    context.init(args=[], domain_id=domain_id)
    node = Node("listener", context=context, start_parameter_services=False, enable_rosout=False)
    try:
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            yield Listener(node)
    finally:
        node.destroy_node()
        context.try_shutdown()
        context.destroy()


class FakeDaemon:
    """A daemon that only reports `mode` and `domain_id`."""

    def __init__(self, robot: str, domain_id: int, mode: str) -> None:
        self.robot = robot
        self.domain_id = domain_id
        self.mode = mode

    async def status(self, _: NoParams) -> dict[str, object]:
        """Answer `status`."""
        return {"robot": self.robot, "domain_id": self.domain_id, "mode": self.mode}

    @asynccontextmanager
    async def running(self) -> AsyncIterator[FakeDaemon]:
        """Listen on the robot's control socket."""
        make_private(runtime_folder())
        methods: dict[str, Method[Any]] = {"status": Method(NoParams, self.status)}
        identity = Identity(self.robot, "0.1.0", os.getpid())
        with ControlServer(socket_path(self.robot), methods, identity) as server:
            task = asyncio.create_task(server.serve())
            try:
                yield self
            finally:
                task.cancel()
                with suppress(asyncio.CancelledError):
                    await task


Daemon = Callable[..., AbstractAsyncContextManager[FakeDaemon]]


@pytest.fixture
def daemon(domain_id: int, own_sockets: None) -> Daemon:
    """A daemon in the test's domain, or in another."""

    def make(
        robot: str = "robot", *, mode: str = "IDLE", domain: int | None = None
    ) -> AbstractAsyncContextManager[FakeDaemon]:
        return FakeDaemon(robot, domain_id if domain is None else domain, mode).running()

    return make
