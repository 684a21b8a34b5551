"""Failures become events, and failed tasks start again."""

from __future__ import annotations

import asyncio
import logging

import pytest

from robotctl.daemon import supervisor
from robotctl.daemon.supervisor import MAX_DETAIL, Supervisor
from robotctl.kernel.types import Cause, Event, FaultReported


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    monkeypatch.setattr(supervisor, "RESTART_S", 0.0)
    return []


async def die_once_of(error: Exception, told: list[Event]) -> str:
    """Run a task that fails and starts again; return the events for the kernel."""
    lives = iter([error])

    async def work() -> None:
        for death in lives:
            raise death

    watched = Supervisor(lambda: None)
    watched.report_to(told.append)
    await watched.run("test", work)
    (fault,) = told
    assert isinstance(fault, FaultReported)
    assert fault.cause is Cause.TASK_DIED
    return fault.detail


async def test_a_failed_task_is_reported_and_started_again(told: list[Event]) -> None:
    assert await die_once_of(ValueError("why"), told) == "the test task failed (ValueError: why)"


async def test_the_exception_of_a_task_group_is_unwrapped(told: list[Event]) -> None:
    wrapped = ExceptionGroup("outer", [ExceptionGroup("inner", [KeyError("deep")])])
    assert "(KeyError: 'deep')" in await die_once_of(wrapped, told)


async def test_a_long_fault_is_shortened_for_the_journal_and_logged_whole(
    told: list[Event], caplog: pytest.LogCaptureFixture
) -> None:
    words = "x" * 10 * MAX_DETAIL
    assert len(await die_once_of(ValueError(words), told)) == MAX_DETAIL
    assert words in caplog.text


async def test_a_fault_before_the_kernel_exists_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        Supervisor(lambda: None).callback_failed(ValueError("early"), "/odom")
    assert "the callback of /odom failed (ValueError: early)" in caplog.text


async def test_an_exception_in_the_loop_is_a_fault_and_anything_else_is_only_logged(
    told: list[Event],
) -> None:
    watched, loop = Supervisor(lambda: None), asyncio.get_running_loop()
    watched.report_to(told.append)
    watched.loop_failed(loop, {"message": "only words"})
    assert told == []
    watched.loop_failed(loop, {"message": "seen", "exception": ValueError("why")})
    assert len(told) == 1
