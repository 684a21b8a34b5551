"""What the control socket promises, however its clients behave."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import socket
import sys
from pathlib import Path
from typing import Any

import pytest

from robotctl.ipc import connection
from robotctl.ipc.protocol import MAX_REQUEST_BYTES, Code, encode_request
from robotctl.ipc.server import Limits
from robotctl.testing.waiting import DEADLINE_S, loop_until


def request(method: str, **params: object) -> bytes:
    return encode_request(7, method, params)


HELLO = request("hello", protocol=1)
ESTOP = request("set_mode", mode=3, source="test")


def open_fds() -> int:
    return len(os.listdir("/proc/self/fd"))


# Who may come in


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


async def test_hello_tells_who_answers(serve: Any, connect: Any) -> None:
    async with serve():
        reply = await (await connect(greet=False)).call("hello", protocol=1)
    assert reply["result"] == {
        "protocol": 1,
        "version": "0.1.0",
        "robot": "robot",
        "pid": os.getpid(),
    }


async def test_hello_and_a_request_may_come_in_one_write(serve: Any, connect: Any) -> None:
    async with serve():
        peer = await connect(greet=False)
        await peer.send(HELLO, request("status"))
        assert "result" in await peer.reply()
        assert (await peer.reply())["result"]["mode"] == 0


async def test_an_unknown_value_is_null(serve: Any, connect: Any) -> None:
    async with serve():
        reply = await (await connect()).call("status")
    assert reply["result"]["battery"] is None


async def test_a_request_before_hello_is_refused(serve: Any, connect: Any, robot: Any) -> None:
    async with serve():
        reply = await (await connect(greet=False)).call("set_mode", mode=1, source="test")
    assert reply["error"]["code"] == Code.INVALID_REQUEST
    assert "hello" in reply["error"]["message"]
    assert robot.mode_requests == 0


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


async def test_an_error_of_ours_crosses_with_text_and_exit_code(
    serve: Any, connect: Any, robot: Any
) -> None:
    robot.mode = 3
    async with serve():
        reply = await (await connect()).call("set_mode", mode=1, source="test")
    assert reply["error"] == {
        "code": -32000,
        "message": "EMERGENCY_STOP is latched: release it with robotctl reset",
        "data": {"exit_code": 4},
    }


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
    monkeypatch.setattr(connection, "MAX_RESPONSE_BYTES", 1_000_000)
    async with serve():
        peer = await connect()
        assert (await peer.call("flood"))["error"]["code"] == Code.INTERNAL_ERROR
        assert "result" in await peer.call("status")


@pytest.mark.parametrize(
    ("method", "params", "named"),
    [
        ("set_mode", {"mode": 256, "source": "x"}, "set_mode: mode: Expected `int` <= 255"),
        ("set_mode", {"mode": 1.0, "source": "x"}, "set_mode: mode: Expected `int`"),
        ("set_mode", {"mode": True, "source": "x"}, "set_mode: mode: Expected `int`"),
        ("set_mode", {"mode": 1}, "set_mode: Object missing required field `source`"),
        ("set_mode", {"mode": 1, "source": "x" * 201}, "set_mode: source: Expected `str`"),
        ("status", {"verbose": True}, "status: Object contains unknown field `verbose`"),
        ("drive", {"pattern": "star", "source": "x"}, "drive: pattern: "),
        (
            "drive",
            {"pattern": "square", "source": "x", "side_m": 1e300},
            "side_m: Expected `float`",
        ),
        ("drive", {"pattern": "square", "source": "x", "side_m": -1}, "side_m: Expected `float`"),
        ("drive", {"pattern": "square", "source": "x", "laps": -1}, "laps: Expected `int` >= 0"),
    ],
)
async def test_a_parameter_outside_its_limits_is_named(
    method: str, params: dict[str, object], named: str, serve: Any, connect: Any, robot: Any
) -> None:
    async with serve():
        reply = await (await connect()).call(method, **params)
    assert reply["error"]["code"] == Code.INVALID_PARAMS
    assert reply["error"]["data"] == {"exit_code": 2}
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


async def test_requests_may_arrive_byte_by_byte(serve: Any, connect: Any) -> None:
    async with serve():
        peer = await connect(greet=False)
        for byte in HELLO + request("status"):
            await peer.send(bytes([byte]))
            await asyncio.sleep(0)
        assert "result" in await peer.reply()
        assert "result" in await peer.reply()


async def test_an_endless_line_is_refused_and_closed(serve: Any, connect: Any) -> None:
    async with serve():
        peer = await connect()
        await peer.send(b"x" * (MAX_REQUEST_BYTES + 1))
        assert "longer than" in (await peer.reply())["error"]["message"]
        assert await peer.is_closed()


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
