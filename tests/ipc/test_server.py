"""The users that the daemon answers, and its answers to valid and invalid requests.
The socket file: its owner, its permissions, and its recreation.
"""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import socket
import stat
import sys
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from typing import Any

import pytest

from robotctl.base.errors import AlreadyRunning, UsageError
from robotctl.ipc import listener
from robotctl.ipc import server as request_handler
from robotctl.ipc.protocol import Code, encode_request
from robotctl.ipc.server import ControlServer
from tests.ipc.conftest import ESTOP, HELLO, IDENTITY, Control, request
from tests.support.waiting import DEADLINE_S, loop_until

# Admission


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
async def test_another_uid_is_refused_every_time(control: Control) -> None:
    rounds = 100
    async with control.serve():
        os.chmod(control.path.parent, 0o711)
        os.chmod(control.path, 0o666)
        program = (
            "import os, socket, sys\n"
            "os.chdir(sys.argv[1])  # as root: the folders above stay closed\n"
            "os.setresgid(65534, 65534, 65534); os.setresuid(65534, 65534, 65534)\n"
            "refused = 0\n"
            f"for _ in range({rounds}):\n"
            "    with socket.socket(socket.AF_UNIX) as s:\n"
            f"        s.settimeout({DEADLINE_S}); s.connect('robot.sock')\n"
            "        try: s.sendall(bytes.fromhex(sys.argv[2]))\n"
            "        except BrokenPipeError: pass\n"
            "        refused += b'belongs to uid 0, not 65534' in s.recv(65536)\n"
            "print(refused)\n"
        )
        child = await asyncio.create_subprocess_exec(
            sys.executable,
            "-c",
            program,
            str(control.path.parent),
            (HELLO + ESTOP).hex(),
            stdout=asyncio.subprocess.PIPE,
        )
        out, _ = await child.communicate()
    assert int(out) == rounds
    assert control.robot.mode_requests == 0


# The dialogue


async def test_hello_returns_the_identity_of_the_daemon(control: Control) -> None:
    async with control.client(greet=False) as peer:
        reply = await peer.call("hello", protocol=1)
    assert reply["result"] == {
        "protocol": 1,
        "version": "0.1.0",
        "robot": "robot",
        "pid": os.getpid(),
    }


async def test_another_protocol_is_named_with_the_way_out(control: Control) -> None:
    async with control.client(greet=False) as peer:
        reply = await peer.call("hello", protocol=2)
        assert reply["error"]["code"] == Code.PROTOCOL_MISMATCH
        assert "speaks protocol 1, this client 2" in reply["error"]["message"]
        assert f"kill {os.getpid()}" in reply["error"]["message"]
        assert "error" in await peer.call("status")


async def test_the_emergency_stop_needs_no_common_protocol(control: Control) -> None:
    async with control.client(greet=False) as peer:
        await peer.send(request("hello", protocol=99), ESTOP)
        assert "error" in await peer.reply()
        assert "result" in await peer.reply()
    assert control.robot.mode == 3


@pytest.mark.parametrize("method", ["break_down", "lose_a_future"])
async def test_a_bug_in_a_handler_is_logged_and_the_connection_lives(
    method: str, caplog: pytest.LogCaptureFixture, control: Control
) -> None:
    async with control.client() as peer:
        reply = await peer.call(method)
        assert reply["error"]["code"] == Code.INTERNAL_ERROR
        assert "result" in await peer.call("status")
    assert f"{method!r} failed" in caplog.text
    assert "Traceback" in caplog.text


async def test_a_reply_over_the_limit_is_an_internal_error(
    monkeypatch: pytest.MonkeyPatch, control: Control
) -> None:
    monkeypatch.setattr(request_handler, "MAX_RESPONSE_BYTES", 1_000_000)
    async with control.client() as peer:
        assert (await peer.call("flood"))["error"]["code"] == Code.INTERNAL_ERROR
        assert "result" in await peer.call("status")


@pytest.mark.parametrize(
    ("method", "params", "named"),
    [
        ("set_mode", {"mode": 256, "source": "x"}, "mode: 256 is not allowed: use a whole"),
        ("set_mode", {"mode": 1.0, "source": "x"}, "mode: 1.0 is not allowed: use a whole"),
        ("set_mode", {"mode": True, "source": "x"}, "mode: True is not allowed: use a whole"),
        ("set_mode", {"mode": 1}, "set_mode: source: missing"),
        ("set_mode", {"mode": 1, "source": "x" * 201}, "use a text of 0 to 200 characters"),
        ("status", {"verbose": True}, "status: no parameter 'verbose': use none"),
        (
            "drive",
            {"pattern": "star", "source": "x"},
            "'star' is not allowed: use square, circle, figure-eight",
        ),
        (
            "drive",
            {"pattern": "square", "source": "x", "side_m": 1e300},
            "drive: side_m: 1e+300 is not allowed: use a number from 0.1 to 100",
        ),
        (
            "drive",
            {"pattern": "square", "source": "x", "side_m": -1},
            "drive: side_m: -1 is not allowed: use a number from 0.1 to 100",
        ),
        (
            "drive",
            {"pattern": "square", "source": "x", "laps": -1},
            "drive: laps: -1 is not allowed: use a whole number from 0 to ",
        ),
    ],
)
async def test_a_parameter_outside_its_limits_is_named(
    method: str, params: dict[str, object], named: str, control: Control
) -> None:
    async with control.client() as peer:
        reply = await peer.call(method, **params)
    assert reply["error"]["code"] == Code.INVALID_PARAMS
    assert reply["error"]["data"]["exit_code"] == 2
    assert named in reply["error"]["message"]
    assert control.robot.mode_requests == 0


async def test_an_unknown_method_is_named(control: Control) -> None:
    async with control.client() as peer:
        reply = await peer.call("fly")
    assert reply["error"]["code"] == Code.METHOD_NOT_FOUND
    assert "'fly'" in reply["error"]["message"]


# Malformed input


async def test_malformed_lines_are_answered_and_change_nothing(control: Control) -> None:
    malformed = [
        b"\n",
        b"not json\n",
        b"\x00\xff\n",
        b'{"jsonrpc":"2.0","id":1,"method":"set_mode","params":{"mode":1,"mode":3}}\n',
        b'{"jsonrpc":"2.0","id":1,"method":"set_mode","params":{"mode":1e999,"source":"x"}}\n',
        b'[{"jsonrpc":"2.0","id":1,"method":"set_mode","params":{"mode":1,"source":"x"}}]\n',
        b'{"jsonrpc":"2.0","method":"set_mode","params":{"mode":1,"source":"x"}}\n',
        b"[" * 60_000 + b"\n",
    ]
    async with control.serve():
        bystander, vandal = await control.connect(), await control.connect()
        for line in malformed:
            await vandal.send(line)
            assert (await vandal.reply())["error"]["code"] in (-32700, -32600)
            assert (await bystander.call("status"))["result"]["mode"] == 0
        assert "result" in await vandal.call("status")
    assert control.robot.mode_requests == 0


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
    monkeypatch: pytest.MonkeyPatch, control: Control
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    async with control.serve() as server:
        assert server.warning() == ""
        before = await control.connect()
        rmtree(control.path.parent)
        await loop_until(control.path.exists)
        await loop_until(server.warning)
        assert "was removed or replaced once" in server.warning()
        assert "result" in await (await control.connect()).call("status")
        assert "result" in await before.call("status")


async def test_a_socket_that_cannot_be_created_again_is_reported_once_and_retried(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, control: Control
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    async with control.serve():
        rmtree(control.path.parent)
        control.path.parent.write_text("in the way")
        await loop_until(lambda: "no client can reach this daemon" in caplog.text)
        await asyncio.sleep(0.05)  # several more attempts
        control.path.parent.unlink()
        await loop_until(control.path.exists)
        assert "result" in await (await control.connect()).call("status")
    assert caplog.text.count("no client can reach this daemon") == 1
    first, last = control.unreachable
    assert first.startswith("no client can reach this daemon: ")
    assert f"{control.path.parent} is not a folder: " in first
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
    thief: str, monkeypatch: pytest.MonkeyPatch, control: Control
) -> None:
    monkeypatch.setattr(listener, "LOOK_S", 0.01)
    with socket.socket(socket.AF_UNIX) as other:
        async with control.serve() as server:
            take(control.path, thief, other)
            await loop_until(lambda: control.unreachable)
            assert "no client can reach this daemon" in control.unreachable[0]
            assert str(control.path.parent) in control.unreachable[0]
            give_back(control.path, thief)
            await loop_until(server.warning)
            assert control.unreachable[1:] == [""]
            assert "result" in await (await control.connect()).call("status")


async def test_without_a_free_descriptor_a_client_can_still_stop_the_robot(
    control: Control,
) -> None:
    async with control.client() as peer:
        await peer.call("status")
        loop, (soft, hard) = asyncio.get_running_loop(), resource.getrlimit(resource.RLIMIT_NOFILE)
        taken: list[int] = []
        with socket.socket(socket.AF_UNIX) as stopping:
            stopping.connect(str(control.path))  # it waits to be accepted
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
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, control: Control
) -> None:
    accept, failures = socket.socket.accept, iter([OSError(24, "too many open files")])

    def fail_once(listener: socket.socket) -> tuple[socket.socket, Any]:
        for failure in failures:
            raise failure
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", fail_once)
    with caplog.at_level(logging.WARNING):
        async with control.client() as peer:
            assert "result" in await peer.call("status")
    assert "no connection can be accepted" in caplog.text
