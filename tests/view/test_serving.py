"""What viewers ask of the robot, and a view without a free descriptor."""

from __future__ import annotations

import asyncio
import errno
import resource
import socket
import struct

import pytest

from robotctl.view.foxglove import WrongRequest
from robotctl.view.remote_control import MAX_CALLS, SERVICES, STOP, RemoteControl, velocity_of
from robotctl.view.serving import LoopFailures
from tests.support.view_client import served, view_client
from tests.support.waiting import loop_until

NO_DAEMON = "no_daemon_has_this_name"


async def test_each_call_of_a_service_is_answered() -> None:
    """Also one of no such service, one with a body that is none, and one more than is allowed."""
    async with served(services=SERVICES) as view, view_client(view.url) as client:
        RemoteControl(NO_DAEMON, view.server, "")
        for call_id, service_id in enumerate([99, STOP.id, *[STOP.id] * MAX_CALLS[STOP.id]]):
            head = struct.pack("<BIII", 2, service_id, call_id, 4_000)
            await client.socket.send(head + b"no body")
        await client.until(lambda: client.responses and len(client.op("serviceCallFailure")) == 2)
        no_such, too_many = client.op("serviceCallFailure")
        assert (no_such["callId"], no_such["message"]) == (0, "there is no such service")
        assert too_many["callId"] == 2
        (answer,) = client.responses
        assert not answer["success"]
        assert "robotctl start" in answer["message"]


def test_a_twist_is_two_numbers() -> None:
    full = b'{"linear": {"x": 0.5, "y": 0, "z": 0.0}, "angular": {"x": 0, "y": 0, "z": -1}}'
    assert velocity_of(full) == (0.5, -1.0)
    assert velocity_of(b'{"linear": {"x": 0.5}, "angular": {"z": 0}}') == (0.5, 0.0)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b'{"linear": {"x": NaN}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1e999}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1, "y": 0.1}, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}, "angular": {"x": 1, "z": 0}}',
        b'{"linear": {"x": "fast"}, "angular": {"z": 0}}',
        b'{"linear": 3, "angular": {"z": 0}}',
        b'{"linear": {"x": 1}}',
        b'{"linear": {"x": ' + b"9" * 400 + b'}, "angular": {"z": 0}}',
    ],
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(WrongRequest):
        velocity_of(data)


async def test_a_viewer_waits_while_no_descriptor_is_free(
    capfd: pytest.CaptureFixture[str],
) -> None:
    asyncio.get_running_loop().set_exception_handler(LoopFailures().handle)
    said: list[str] = []

    def is_said() -> bool:
        said.append(capfd.readouterr().err)
        return "Too many open files" in "".join(said)

    async with served() as view:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        with socket.socket() as client:
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))  # with less, poll fails
            try:
                client.connect(("127.0.0.1", view.port))
                await loop_until(is_said)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            await loop_until(lambda: len(view.server._connections) == 1)
    assert "".join(said) == (
        "robotctl view: Too many open files: new viewers wait; raise the limit (ulimit -n), or "
        "close other viewers\n"
    )


async def test_a_lack_that_lasts_is_said_once_and_another_failure_as_ever(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    loop, failures = asyncio.get_running_loop(), LoopFailures()
    for _ in range(3):
        error = OSError(errno.ENFILE, "Too many open files in system")
        failures.handle(loop, {"message": "socket.accept()", "exception": error})
    assert capfd.readouterr().err.count("\n") == 1
    failures.handle(loop, {"message": "a callback failed", "exception": ValueError("wrong")})
    assert "a callback failed" in caplog.text
