"""Clients that are slow, silent, too many or never stop asking."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import socket
from pathlib import Path
from typing import Any

import pytest

from robotctl.ipc import connection
from robotctl.ipc.protocol import Code, encode_request
from robotctl.ipc.server import Limits
from robotctl.testing.waiting import DEADLINE_S, loop_until


def request(method: str, **params: object) -> bytes:
    return encode_request(7, method, params)


HELLO = request("hello", protocol=1)
ESTOP = request("set_mode", mode=3, source="test")


def open_fds() -> int:
    return len(os.listdir("/proc/self/fd"))


# Slow clients and deadlines


async def test_half_a_request_is_closed_at_its_deadline(serve: Any, connect: Any) -> None:
    async with serve(Limits(request_s=0.05)):
        peer = await connect(greet=False)
        await peer.send(HELLO[:-5])
        assert (await peer.reply())["error"]["code"] == Code.TIMEOUT
        assert await peer.is_closed()


async def test_a_client_that_takes_no_reply_does_not_hold_up_others(
    serve: Any, connect: Any, path: Path
) -> None:
    async with serve(Limits(write_s=0.05)):
        fds = open_fds()
        with socket.socket(socket.AF_UNIX) as slow:
            slow.connect(str(path))
            slow.sendall(HELLO + request("flood"))
            peer = await connect()
            assert "result" in await peer.call("status")
            await loop_until(lambda: open_fds() == fds + 3)  # slow, and both ends of peer


async def test_a_call_ends_at_its_deadline(serve: Any, connect: Any, robot: Any) -> None:
    async with serve():
        peer = await connect()
        reply = await peer.call("slow")
        assert reply["error"]["code"] == Code.TIMEOUT
        assert "slow took longer than 0.05 s" in reply["error"]["message"]
        assert robot.calls_under_way == 0
        assert "result" in await peer.call("status")


async def test_a_call_without_a_deadline_ends_when_its_client_leaves(
    serve: Any, connect: Any, robot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "_HANGUP_POLL_S", 0.01)
    async with serve():
        peer = await connect()
        await peer.send(request("wait"))
        await robot.called.wait()
        peer.writer.close()
        async with asyncio.timeout(DEADLINE_S):
            await robot.left.wait()


async def test_a_client_that_only_closed_its_sending_half_is_answered(
    serve: Any, connect: Any, robot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "_HANGUP_POLL_S", 0.001)
    async with serve():
        peer = await connect()
        await peer.send(request("wait"))
        peer.writer.write_eof()
        await robot.called.wait()
        await asyncio.sleep(0.02)  # several looks at the socket
        robot.never.set()
        assert (await peer.reply())["result"] == {}
        assert await peer.is_closed()


async def test_a_call_under_way_is_told_that_the_daemon_stops(
    serve: Any, connect: Any, robot: Any
) -> None:
    async with serve():
        peer = await connect()
        await peer.send(request("wait"))
        await robot.called.wait()
    reply = await peer.reply()
    assert reply["error"]["message"] == "the daemon is stopping"
    assert reply["error"]["data"] == {"exit_code": 3}
    assert await peer.is_closed()


async def test_the_end_closes_idle_connections(serve: Any, connect: Any) -> None:
    async with serve():
        peer = await connect()
    assert await peer.is_closed()


async def test_the_loop_turns_between_two_requests_of_one_client(
    serve: Any, connect: Any, robot: Any
) -> None:
    turn, seen, status = 0, [], robot.status

    async def noted(params: Any) -> Any:
        seen.append(turn)
        return await status(params)

    robot.status = noted
    async with serve():
        peer = await connect()
        await peer.send(request("status") * 100)
        async with asyncio.timeout(DEADLINE_S):
            while len(seen) < 100:
                turn += 1
                await asyncio.sleep(0)
    assert len(set(seen)) == 100


# Too many clients


async def test_a_client_over_the_cap_is_told_busy(serve: Any, connect: Any) -> None:
    async with serve(Limits(clients=1)):
        first, second = await connect(), await connect()
        reply = await second.call("status")
        assert reply["error"]["code"] == Code.BUSY
        assert reply["error"]["data"] == {"exit_code": 4}
        assert await second.is_closed()
        assert "result" in await first.call("status")


@pytest.mark.parametrize("lines", [[ESTOP], [HELLO, ESTOP]])
async def test_a_client_over_the_cap_may_still_stop_the_robot(
    lines: list[bytes], serve: Any, connect: Any, robot: Any
) -> None:
    async with serve(Limits(clients=1)):
        await connect()
        peer = await connect(greet=False)
        await peer.send(*lines)
        for _ in lines:
            assert "result" in await peer.reply()
        assert robot.mode == 3


async def test_a_silent_client_over_the_cap_loses_its_place(serve: Any, connect: Any) -> None:
    async with serve(Limits(clients=1, overflow=1, overflow_request_s=0.05)):
        await connect()
        silent = await connect(greet=False)
        waiting = await connect(greet=False)
        await waiting.send(ESTOP)
        assert (await silent.reply())["error"]["code"] == Code.TIMEOUT
        assert "result" in await waiting.reply()


async def test_a_place_is_free_again_when_its_client_leaves(serve: Any, connect: Any) -> None:
    async with serve(Limits(clients=1)):
        fds = open_fds()
        first = await connect()
        first.writer.close()
        await loop_until(lambda: open_fds() == fds)
        assert "result" in await (await connect()).call("status")


async def test_1000_clients_at_once_are_all_answered_or_told_busy(
    serve: Any, path: Path, robot: Any
) -> None:
    count = 1000
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))
    fds = open_fds()
    loop = asyncio.get_running_loop()
    async with serve():
        clients = [socket.socket(socket.AF_UNIX) for _ in range(count)]

        def rush() -> None:
            for client in clients:
                client.connect(str(path))
                client.sendall(HELLO + request("status"))
                client.setblocking(False)

        await asyncio.to_thread(rush)
        answered = busy = 0
        async with asyncio.timeout(DEADLINE_S * 3):
            for client in clients:
                reply = b""
                while reply.count(b"\n") < 2:
                    data = await loop.sock_recv(client, 65536)
                    assert data, f"closed after {reply!r}"
                    reply += data
                last = json.loads(reply.splitlines()[1])
                answered += "result" in last
                busy += last.get("error", {}).get("code") == Code.BUSY
                client.close()
        assert answered + busy == count
        assert answered >= Limits().clients
    await loop_until(lambda: open_fds() == fds)


@pytest.mark.parametrize("rounds", [500, pytest.param(10_000, marks=pytest.mark.slow)])
async def test_no_file_descriptor_is_left_behind(rounds: int, serve: Any, path: Path) -> None:
    endings = [
        b"",
        HELLO,
        HELLO + request("status"),
        HELLO[:-3],
        b"junk\n",
        HELLO + request("wait"),
    ]
    async with serve():
        fds = open_fds()
        for turn in range(rounds):
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(path))
                client.sendall(endings[turn % len(endings)])
            if turn % 50 == 0:
                await asyncio.sleep(0)
        await loop_until(lambda: open_fds() == fds)
