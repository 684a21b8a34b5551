"""The socket file: its owner, its permissions, and its recreation."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import socket
import stat
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from typing import Any

import pytest

from robotctl.base.errors import AlreadyRunning, UsageError
from robotctl.ipc import listener
from robotctl.ipc.protocol import encode_request
from robotctl.ipc.request_handler import Identity
from robotctl.ipc.server import ControlServer
from tests.support.waiting import loop_until

IDENTITY = Identity("robot", "0.1.0", 1)


def test_the_socket_is_private_with_any_umask(path: Path) -> None:
    previous = os.umask(0)
    try:
        with ControlServer(path, {}, IDENTITY):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert os.umask(0) == 0
    finally:
        os.umask(previous)


def test_a_dead_daemons_socket_is_replaced(path: Path) -> None:
    with ControlServer(path, {}, IDENTITY):
        dead = path.with_suffix(".dead")
        path.rename(dead)
    dead.rename(path)
    with ControlServer(path, {}, IDENTITY), socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))


def test_a_file_at_the_sockets_path_is_left_alone(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("precious")
    with pytest.raises(UsageError, match="is not a socket"), ControlServer(path, {}, IDENTITY):
        pass
    assert path.read_text() == "precious"


def test_another_servers_socket_survives_our_end(path: Path) -> None:
    with ControlServer(path, {}, IDENTITY):
        path.unlink()
        with socket.socket(socket.AF_UNIX) as other:
            other.bind(str(path))
    assert path.is_socket()


@pytest.mark.parametrize("waiting", [0, 2])
def test_a_living_daemons_socket_is_left_alone(
    path: Path, waiting: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "BACKLOG", 0)
    with ControlServer(path, {}, IDENTITY):
        clients = [socket.socket(socket.AF_UNIX) for _ in range(waiting)]
        for client in clients:
            client.setblocking(False)
            with suppress(BlockingIOError):
                client.connect(str(path))
        said = "is in use" if waiting else f"pid {os.getpid()} answers at"
        with pytest.raises(AlreadyRunning, match=said), ControlServer(path, {}, IDENTITY):
            pass
        assert path.is_socket()
        for client in clients:
            client.close()


async def test_a_removed_socket_is_created_again(
    path: Path, serve: Any, connect: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    async with serve() as server:
        assert server.warning() == ""
        before = await connect()
        rmtree(path.parent)
        await loop_until(path.exists)
        await loop_until(server.warning)
        assert "was removed or replaced once" in server.warning()
        assert "result" in await (await connect()).call("status")
        assert "result" in await before.call("status")


async def test_a_socket_that_cannot_be_created_again_is_reported_once_and_retried(
    path: Path,
    serve: Any,
    connect: Any,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    unreachable: list[str],
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    async with serve():
        rmtree(path.parent)
        path.parent.write_text("in the way")
        await loop_until(lambda: "no client can reach this daemon" in caplog.text)
        await asyncio.sleep(0.05)  # several more attempts
        path.parent.unlink()
        await loop_until(path.exists)
        assert "result" in await (await connect()).call("status")
    assert caplog.text.count("no client can reach this daemon") == 1
    first, last = unreachable
    assert first.startswith(f"no client can reach this daemon: {path.parent} is not a folder: ")
    assert last == ""


def take(path: Path, thief: str, other: socket.socket) -> None:
    ours = path.rename(path.with_suffix(".ours"))
    match thief:
        case "file":
            path.write_text("mine")
        case "another server":
            other.bind(str(path))
            other.listen()
        case "link":
            path.symlink_to(ours)
        case _:
            ours.rename(path)
            path.parent.chmod(0o777)


def give_back(path: Path, thief: str) -> None:
    if thief == "open folder":
        path.parent.chmod(0o700)
    else:
        path.unlink()


@pytest.mark.parametrize("thief", ["file", "another server", "link", "open folder"])
async def test_a_replaced_socket_is_created_again_when_its_path_is_free(
    thief: str,
    path: Path,
    serve: Any,
    connect: Any,
    monkeypatch: pytest.MonkeyPatch,
    unreachable: list[str],
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    with socket.socket(socket.AF_UNIX) as other:
        async with serve() as server:
            take(path, thief, other)
            await loop_until(lambda: unreachable)
            assert "no client can reach this daemon" in unreachable[0]
            assert str(path.parent) in unreachable[0]
            give_back(path, thief)
            await loop_until(server.warning)
            assert unreachable[1:] == [""]
            assert "result" in await (await connect()).call("status")


async def test_without_a_free_descriptor_a_client_can_still_stop_the_robot(
    serve: Any, connect: Any, path: Path
) -> None:
    async with serve():
        await (await connect()).call("status")
        loop, (soft, hard) = asyncio.get_running_loop(), resource.getrlimit(resource.RLIMIT_NOFILE)
        taken: list[int] = []
        with socket.socket(socket.AF_UNIX) as stopping:
            stopping.connect(str(path))  # it waits to be accepted
            stopping.setblocking(False)
            try:
                with suppress(OSError):
                    resource.setrlimit(resource.RLIMIT_NOFILE, (stopping.fileno() + 8, hard))
                    while True:
                        taken.append(os.open(os.devnull, os.O_RDONLY))
                estop = encode_request(7, "set_mode", {"mode": 3, "source": "test"})
                await loop.sock_sendall(stopping, estop)
                async with asyncio.timeout(5.0):  # an idle client makes room after 10 s
                    assert b"result" in await loop.sock_recv(stopping, 1000)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
                for each in taken:
                    os.close(each)


async def test_running_out_of_descriptors_is_survived(
    serve: Any, connect: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    accept, failures = socket.socket.accept, iter([OSError(24, "too many open files")])

    def fail_once(listener: socket.socket) -> tuple[socket.socket, Any]:
        for failure in failures:
            raise failure
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", fail_once)
    with caplog.at_level(logging.WARNING):
        async with serve():
            assert "result" in await (await connect()).call("status")
    assert "no connection can be accepted" in caplog.text
