"""Replays in separate processes, received in this one, and daemons that only report their state."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

import tests.support.rosidl_parser  # noqa: F401
from robotctl.base.paths import make_private, runtime_folder, socket_path
from robotctl.ipc.method_params import NoParams
from robotctl.ipc.server import ControlServer, Identity, Method
from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.bags import STRING, Line, write_bag
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


@pytest.fixture
def own_sockets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use control sockets of this test only."""
    base = Path(os.environ["XDG_RUNTIME_DIR"])
    folder = base / f"{len(list(base.iterdir()))}"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


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


class Stage:
    """A recording, replays of it, and a node of this process that receives what they send.

    `heard` has the serialized messages by topic, in order.
    """

    def __init__(self, folder: Path, domain_id: int, node: Any) -> None:
        self.file = folder / "run.mcap"
        self.domain_id = domain_id
        self.node = node
        self.heard: dict[str, list[bytes]] = {}
        self.started: list[Running] = []

    def bag(self, lines: list[Line], *, heard: bool = False, chunk_bytes: int = 1 << 20) -> Path:
        """Write the recording; subscribe to its topics if it is to be `heard`."""
        types = {f"/{each.topic.lstrip('/')}": each.type_name for each in lines if heard}
        for topic, type_name in types.items():
            self.listen(topic, type_name=type_name)
        return write_bag(self.file, lines, chunk_bytes=chunk_bytes)

    def listen(self, *topics: str, type_name: str = STRING, qos: Any = 1000) -> None:
        """Subscribe."""
        from robotctl.ros.message_types import message_class

        for topic in topics:
            heard = self.heard.setdefault(topic, [])
            tap = RawTap(lambda data, *_, heard=heard: heard.append(data))
            self.node.create_subscription(message_class(type_name), topic, tap, qos, raw=True)

    def start(self, *arguments: object) -> Running:
        """Start a replay in the domain."""
        self.started.append(Running(*map(str, arguments)))
        return self.started[-1]

    async def replay(self, *arguments: object) -> Ran:
        """Run a replay in the domain."""
        return await self.start(*arguments).end()

    def daemon(
        self, robot: str = "robot", *, mode: str = "IDLE"
    ) -> AbstractAsyncContextManager[FakeDaemon]:
        """Return a daemon in the domain."""
        return FakeDaemon(robot, self.domain_id, mode).running()


@pytest.fixture
async def stage(tmp_path: Path, domain_id: int, own_sockets: None) -> AsyncIterator[Stage]:
    from rclpy.context import Context
    from rclpy.node import Node

    context = Context()
    context.init(args=[], domain_id=domain_id)
    node = Node("listener", context=context, start_parameter_services=False, enable_rosout=False)
    made = Stage(tmp_path, domain_id, node)
    try:
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            yield made
    finally:
        for each in made.started:
            each.close()
        node.destroy_node()
        context.try_shutdown()
        context.destroy()
