"""The users that the daemon answers, and its answers to valid and invalid requests."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from robotctl.ipc import request_handler
from robotctl.ipc.protocol import Code, encode_request
from tests.support.waiting import DEADLINE_S


def request(method: str, **params: object) -> bytes:
    return encode_request(7, method, params)


HELLO = request("hello", protocol=1)
ESTOP = request("set_mode", mode=3, source="test")


# Admission


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
async def test_another_uid_is_refused_every_time(path: Path, serve: Any, robot: Any) -> None:
    rounds = 1000
    async with serve():
        os.chmod(path.parent, 0o711)
        os.chmod(path, 0o666)
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
            str(path.parent),
            (HELLO + ESTOP).hex(),
            stdout=asyncio.subprocess.PIPE,
        )
        out, _ = await child.communicate()
    assert int(out) == rounds
    assert robot.mode_requests == 0


# The dialogue


async def test_hello_returns_the_identity_of_the_daemon(serve: Any, connect: Any) -> None:
    async with serve():
        reply = await (await connect(greet=False)).call("hello", protocol=1)
    assert reply["result"] == {
        "protocol": 1,
        "version": "0.1.0",
        "robot": "robot",
        "pid": os.getpid(),
    }


async def test_an_unknown_value_is_null(serve: Any, connect: Any) -> None:
    async with serve():
        reply = await (await connect()).call("status")
    assert reply["result"]["battery"] is None


async def test_another_protocol_is_named_with_the_way_out(serve: Any, connect: Any) -> None:
    async with serve():
        peer = await connect(greet=False)
        reply = await peer.call("hello", protocol=2)
        assert reply["error"]["code"] == Code.PROTOCOL_MISMATCH
        assert "speaks protocol 1, this client 2" in reply["error"]["message"]
        assert f"kill {os.getpid()}" in reply["error"]["message"]
        assert "error" in await peer.call("status")


async def test_the_emergency_stop_needs_no_common_protocol(
    serve: Any, connect: Any, robot: Any
) -> None:
    async with serve():
        peer = await connect(greet=False)
        await peer.send(request("hello", protocol=99), ESTOP)
        assert "error" in await peer.reply()
        assert "result" in await peer.reply()
    assert robot.mode == 3


@pytest.mark.parametrize("method", ["break_down", "lose_a_future"])
async def test_a_bug_in_a_handler_is_logged_and_the_connection_lives(
    method: str, serve: Any, connect: Any, caplog: pytest.LogCaptureFixture
) -> None:
    async with serve():
        peer = await connect()
        reply = await peer.call(method)
        assert reply["error"]["code"] == Code.INTERNAL_ERROR
        assert "result" in await peer.call("status")
    assert f"{method!r} failed" in caplog.text
    assert "Traceback" in caplog.text


async def test_a_reply_over_the_limit_is_an_internal_error(
    serve: Any, connect: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_handler, "MAX_RESPONSE_BYTES", 1_000_000)
    async with serve():
        peer = await connect()
        assert (await peer.call("flood"))["error"]["code"] == Code.INTERNAL_ERROR
        assert "result" in await peer.call("status")


@pytest.mark.parametrize(
    ("method", "params", "named"),
    [
        (
            "set_mode",
            {"mode": 256, "source": "x"},
            "mode: 256 is not allowed: use a whole",
        ),
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
    method: str, params: dict[str, object], named: str, serve: Any, connect: Any, robot: Any
) -> None:
    async with serve():
        reply = await (await connect()).call(method, **params)
    assert reply["error"]["code"] == Code.INVALID_PARAMS
    assert reply["error"]["data"]["exit_code"] == 2
    assert named in reply["error"]["message"]
    assert robot.mode_requests == 0


async def test_an_unknown_method_is_named(serve: Any, connect: Any) -> None:
    async with serve():
        reply = await (await connect()).call("fly")
    assert reply["error"]["code"] == Code.METHOD_NOT_FOUND
    assert "'fly'" in reply["error"]["message"]


# Malformed input


async def test_malformed_lines_are_answered_and_change_nothing(
    serve: Any, connect: Any, robot: Any
) -> None:
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
    async with serve():
        bystander, vandal = await connect(), await connect()
        for line in malformed:
            await vandal.send(line)
            assert (await vandal.reply())["error"]["code"] in (-32700, -32600)
            assert (await bystander.call("status"))["result"]["mode"] == 0
        assert "result" in await vandal.call("status")
    assert robot.mode_requests == 0
