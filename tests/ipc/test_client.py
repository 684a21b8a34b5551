"""A call returns an answer, or one error that says what to do, within its deadline."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotctl.base.errors import NoDaemon, Refused, RobotctlError
from robotctl.ipc import client as client_module
from robotctl.ipc.client import NoAnswer, call
from robotctl.ipc.protocol import Code, encode_error
from tests.ipc.conftest import Control
from tests.support.lines import run_python

NO_DAEMON = "no daemon for robot 'robot' (start one with: robotctl start)"
type_script = Callable[[socket.socket], None]


def result(number: int, **values: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": number, "result": values}


HELLO_REPLY = result(0, protocol=1)


@contextmanager
def daemon(path: Path, script: type_script, connections: int = 1) -> Iterator[None]:
    """A server at `path` that handles each client as the script says."""
    path.parent.mkdir(exist_ok=True)

    def serve() -> None:
        for _ in range(connections):
            sock, _address = listener.accept()
            with sock:
                script(sock)

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield
        finally:
            thread.join()


def send(sock: socket.socket, *replies: object) -> None:
    for reply in replies:
        sock.sendall(reply if isinstance(reply, bytes) else json.dumps(reply).encode() + b"\n")


def answers(*replies: object) -> type_script:
    """Read requests, send these replies, and close after the client has disconnected."""

    def script(sock: socket.socket) -> None:
        sock.recv(65536)
        send(sock, *replies)
        sock.recv(65536)

    return script


# No daemon


@pytest.mark.parametrize(
    ("robot", "text"),
    [
        ("robot", NO_DAEMON),
        ("r2", "no daemon for robot 'r2' (start one with: robotctl start --robot r2)"),
    ],
)
def test_an_absent_socket_says_how_to_start(path: Path, robot: str, text: str) -> None:
    with pytest.raises(NoDaemon) as caught:
        call(robot, "status")
    assert str(caught.value) == text


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
def test_another_users_socket_is_named(path: Path) -> None:
    path.parent.mkdir(mode=0o700)
    program = (
        "import os; from robotctl.ipc.client import call\n"
        "from robotctl.base.errors import Refused\n"
        "os.setresuid(65534, 65534, 65534)\n"
        "try: call('robot', 'status')\n"
        "except Refused as error: print(error)\n"
    )
    ran = run_python(program)
    assert ran.stdout == f"{path} belongs to another user\n", ran.stderr


# A daemon that misbehaves


def test_hello_and_the_request_leave_in_one_write(path: Path) -> None:
    received: list[bytes] = []

    def script(sock: socket.socket) -> None:
        received.append(sock.recv(65536))
        send(sock, HELLO_REPLY, result(1, mode="IDLE"))

    with daemon(path, script):
        assert call("robot", "status") == {"mode": "IDLE"}
    methods = [json.loads(line)["method"] for line in received[0].splitlines()]
    assert methods == ["hello", "status"]


def test_a_silent_daemon_is_given_up_at_the_deadline(path: Path) -> None:
    with (
        daemon(path, answers()),
        pytest.raises(NoAnswer, match=r"did not answer within 0.05 s \(see: robotctl logs\)"),
    ):
        call("robot", "status", deadline_s=0.05)


def test_a_full_backlog_is_waited_for_until_the_deadline(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "CALL_DEADLINE_S", 0.05)
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX) as listener, socket.socket(socket.AF_UNIX) as waiting:
        listener.bind(str(path))
        listener.listen(0)
        waiting.connect(str(path))
        with pytest.raises(NoDaemon, match="did not answer"):
            call("robot", "status")


def test_a_daemon_that_closes_is_named(path: Path) -> None:
    with (
        daemon(path, lambda sock: None),
        pytest.raises(NoDaemon, match="closed the connection before it answered"),
    ):
        call("robot", "status")


@pytest.mark.parametrize(
    "reply",
    [
        b"garbage\n",
        b"[" * 1000 + b"\n",
        result(99),
        {"jsonrpc": "2.0", "id": 1, "result": [1]},
        {"jsonrpc": "2.0", "id": 1, "error": {"code": -32603, "message": "boom"}},
    ],
)
def test_an_answer_out_of_order_is_an_error_of_ours(path: Path, reply: object) -> None:
    with daemon(path, answers(HELLO_REPLY, reply)), pytest.raises(RobotctlError) as caught:
        call("robot", "status")
    assert caught.value.exit_code == 1


def test_a_daemon_of_another_protocol_is_named_with_the_way_out(path: Path) -> None:
    told = rf"protocol 2, this client 1: stop it with kill {os.getpid()}"
    with daemon(path, answers(result(0, protocol=2))), pytest.raises(Refused, match=told):
        call("robot", "status")


def test_the_emergency_stop_gets_through_to_a_daemon_of_another_protocol(path: Path) -> None:
    refused = encode_error(0, Code.PROTOCOL_MISMATCH, "protocol 2", 4)
    with daemon(path, answers(refused, result(1, mode="EMERGENCY_STOP"))):
        answer = call("robot", "set_mode", {"mode": 3, "source": "test"})
    assert answer == {"mode": "EMERGENCY_STOP"}


def test_why_an_emergency_stop_was_refused_is_not_lost(path: Path) -> None:
    refused = encode_error(None, Code.FORBIDDEN, "not yours", 4)
    with daemon(path, lambda sock: send(sock, refused)), pytest.raises(Refused, match="not yours"):
        call("robot", "set_mode", {"mode": 3, "source": "test"})


def test_a_call_without_a_deadline_outlasts_silence_while_the_daemon_answers_others(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The time before the client checks, and the daemon's time to answer the check.
    monkeypatch.setattr(client_module, "LIVENESS_S", 0.5)
    asked_again = threading.Event()

    def script(sock: socket.socket) -> None:
        lines = sock.recv(65536).splitlines()
        send(sock, HELLO_REPLY)
        if len(lines) == 1:
            asked_again.set()
            return

        def finish() -> None:
            asked_again.wait()
            send(kept, result(1, laps=1))
            kept.close()

        kept = sock.dup()
        threading.Thread(target=finish).start()

    with daemon(path, script, connections=2):
        assert call("robot", "drive", {}, deadline_s=None) == {"laps": 1}


# Against the real server


async def test_a_refusal_arrives_as_the_error_that_was_raised(control: Control) -> None:
    control.robot.mode = 3
    async with control.serve():
        with pytest.raises(Refused, match="release it with robotctl reset"):
            await asyncio.to_thread(call, "robot", "set_mode", {"mode": 1, "source": "test"})


async def test_a_busy_daemon_still_takes_the_clients_emergency_stop(control: Control) -> None:
    async with control.client(clients=1):
        with pytest.raises(Refused, match="busy with 1 clients"):
            await asyncio.to_thread(call, "robot", "status")
        await asyncio.to_thread(call, "robot", "set_mode", {"mode": 3, "source": "test"})
    assert control.robot.mode == 3


async def test_the_end_of_the_daemon_ends_a_call_under_way(control: Control) -> None:
    async with control.serve():
        waiting = asyncio.create_task(asyncio.to_thread(call, "robot", "wait", deadline_s=None))
        await control.robot.called.wait()
    with pytest.raises(NoDaemon, match="the daemon is stopping"):
        await waiting
