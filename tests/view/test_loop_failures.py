"""A view without a free descriptor says so in a line, and takes the viewer later."""

from __future__ import annotations

import asyncio
import errno
import resource
import socket

import pytest

from robotctl.view.loop_failures import LoopFailures
from tests.support.view_client import served
from tests.support.waiting import loop_until


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
