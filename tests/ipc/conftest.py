"""A control server in this loop, with a fake robot that only has a mode."""

from __future__ import annotations

import asyncio
import json
import os
import resource
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import Refused
from robotctl.base.paths import socket_path
from robotctl.ipc.method_params import DriveParams, NoParams, ResetParams, SetModeParams
from robotctl.ipc.protocol import encode_request
from robotctl.ipc.server import ClientLimits, ControlServer, Identity, Method
from tests.support.waiting import DEADLINE_S


def request(method: str, **params: object) -> bytes:
    return encode_request(7, method, params)


HELLO = request("hello", protocol=1)
ESTOP = request("set_mode", mode=3, source="test")
IDENTITY = Identity("robot", "0.1.0", 1)


class FakeRobot:
    """Answers as the daemon does; `never` is what its endless calls wait for."""

    def __init__(self) -> None:
        self.mode = 0
        self.mode_requests = 0
        self.calls_under_way = 0
        self.called = asyncio.Event()
        self.left = asyncio.Event()
        self.never = asyncio.Event()

    async def status(self, _: NoParams) -> dict[str, object]:
        return {"mode": self.mode, "battery": float("nan")}

    async def set_mode(self, params: SetModeParams) -> dict[str, object]:
        self.mode_requests += 1
        if params.mode == 1 and self.mode == 3:
            raise Refused("EMERGENCY_STOP is latched: release it with robotctl reset")
        self.mode = params.mode
        return {"message": f"Mode changed to {params.mode}", "mode": str(params.mode)}

    async def reset(self, _: ResetParams) -> dict[str, object]:
        self.mode = 0
        return {"message": "Mode changed to IDLE", "mode": "IDLE"}

    async def drive(self, params: DriveParams) -> dict[str, object]:
        return {"message": f"driving {params.pattern}", "mode": "MOVING"}

    async def wait(self, _: NoParams) -> dict[str, object]:
        self.calls_under_way += 1
        self.called.set()
        try:
            await self.never.wait()
        finally:
            self.calls_under_way -= 1
            self.left.set()
        return {}

    async def break_down(self, _: NoParams) -> dict[str, object]:
        raise ZeroDivisionError("a bug")

    async def lose_a_future(self, _: NoParams) -> dict[str, object]:
        raise asyncio.CancelledError

    async def flood(self, _: NoParams) -> dict[str, object]:
        return {"text": "x" * 4_000_000}

    def methods(self) -> dict[str, Method[Any]]:
        return {
            "status": Method(NoParams, self.status),
            "set_mode": Method(SetModeParams, self.set_mode),
            "reset": Method(ResetParams, self.reset),
            "drive": Method(DriveParams, self.drive),
            "wait": Method(NoParams, self.wait, deadline_s=None),
            "slow": Method(NoParams, self.wait, deadline_s=0.05),
            "break_down": Method(NoParams, self.break_down),
            "lose_a_future": Method(NoParams, self.lose_a_future),
            "flood": Method(NoParams, self.flood),
        }


class Peer:
    """A raw client: sends any bytes, reads replies, each within a deadline."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    async def send(self, *messages: bytes) -> None:
        self.writer.write(b"".join(messages))
        await self.writer.drain()

    async def reply(self) -> dict[str, Any]:
        async with asyncio.timeout(DEADLINE_S):
            line = await self.reader.readline()
        assert line.endswith(b"\n"), f"the server closed after {line!r}"
        reply: dict[str, Any] = json.loads(line)
        return reply

    async def call(self, method: str, **params: object) -> dict[str, Any]:
        await self.send(encode_request(7, method, params))
        return await self.reply()

    async def is_closed(self) -> bool:
        async with asyncio.timeout(DEADLINE_S):
            return await self.reader.read(1) == b""


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return socket_path("robot")


class Control:
    """A server at `path` for a fake robot, and raw clients."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.robot: Any = FakeRobot()
        self.unreachable: list[str] = []
        """The problems that the server reports as unreachable."""

        self.peers: list[Peer] = []

    @asynccontextmanager
    async def serve(self, **limits: Any) -> AsyncIterator[ControlServer]:
        """Serve until the block ends."""
        with ControlServer(
            self.path,
            self.robot.methods(),
            Identity("robot", "0.1.0", os.getpid()),
            limits=ClientLimits(**limits),
            on_unreachable=self.unreachable.append,
        ) as server:
            task = asyncio.create_task(server.serve())
            try:
                yield server
            finally:
                task.cancel()
                with suppress(asyncio.CancelledError):
                    await task

    async def connect(self, *, greet: bool = True) -> Peer:
        """Connect a client, which says hello."""
        peer = Peer(*await asyncio.open_unix_connection(str(self.path), limit=16_000_000))
        self.peers.append(peer)
        if greet:
            assert "result" in await peer.call("hello", protocol=1)
        return peer

    @asynccontextmanager
    async def client(self, *, greet: bool = True, **limits: Any) -> AsyncIterator[Peer]:
        """Serve a client until the block ends."""
        async with self.serve(**limits):
            yield await self.connect(greet=greet)


@pytest.fixture
async def control(path: Path) -> AsyncIterator[Control]:
    made = Control(path)
    yield made
    for peer in made.peers:
        peer.writer.close()


@pytest.fixture
def many_files() -> None:
    """Let this process open more files than a client has connections."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))
