"""Log lines reach the loop from any thread; none waits, none is lost silently, none breeds more."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable

import pytest

from robotctl.daemon.log.lines import WRITTEN
from robotctl.daemon.log.loop_handler import CAPACITY, LINES_PER_TURN, LoopHandler
from tests.support.waiting import loop_until


@pytest.fixture
def log() -> logging.Logger:
    made = logging.Logger("a.logger")
    made.setLevel(logging.INFO)
    return made


def handler_of(
    log: logging.Logger, publish: Callable[[logging.LogRecord, str], None]
) -> LoopHandler:
    handler = LoopHandler(asyncio.get_running_loop(), publish)
    log.addHandler(handler)
    return handler


async def test_lines_of_other_threads_are_published_in_the_loop(log: logging.Logger) -> None:
    told: list[tuple[str, str, int]] = []

    def publish(record: logging.LogRecord, text: str) -> None:
        told.append((record.levelname, text, threading.get_ident()))

    handler_of(log, publish)
    thread = threading.Thread(target=lambda: log.warning("from %s", "a\nthread"))
    thread.start()
    await loop_until(lambda: told)
    thread.join()
    assert told == [("WARNING", "from a\n    thread", threading.get_ident())]


async def test_a_line_is_not_published_where_it_is_logged(log: logging.Logger) -> None:
    told: list[str] = []
    handler_of(log, lambda record, text: told.append(text))
    log.info("later")
    assert told == []
    await loop_until(lambda: told == ["later"])


async def test_a_burst_leaves_turns_of_the_loop_to_others(log: logging.Logger) -> None:
    told: list[str] = []
    handler_of(log, lambda record, text: told.append(text))
    for number in range(3 * LINES_PER_TURN):
        log.info("%d", number)
    seen = []
    while len(told) < 3 * LINES_PER_TURN:
        await asyncio.sleep(0)
        seen.append(len(told))
    steps = [late - early for early, late in zip([0, *seen], seen, strict=False)]
    assert max(steps) == LINES_PER_TURN


async def test_lines_that_do_not_fit_are_counted_and_told(log: logging.Logger) -> None:
    told: list[str] = []
    handler_of(log, lambda record, text: told.append(text))
    for number in range(CAPACITY + 7):
        log.info("%d", number)
    await loop_until(lambda: len(told) > CAPACITY)
    assert told[CAPACITY - 1] == str(CAPACITY - 1)
    assert told[CAPACITY:] == ["7 log lines are missing here: the log file has them"]


async def test_a_line_that_cannot_be_published_is_counted_and_told(log: logging.Logger) -> None:
    told: list[str] = []

    def publish(record: logging.LogRecord, text: str) -> None:
        if text == "bad":
            raise RuntimeError("the middleware failed")
        told.append(text)

    handler_of(log, publish)
    log.info("bad")
    log.info("good")
    await loop_until(lambda: len(told) == 2)
    assert told == ["good", "1 log lines are missing here: the log file has them"]


async def test_what_publishing_logs_leads_to_no_further_line(log: logging.Logger) -> None:
    told: list[str] = []

    def publish(record: logging.LogRecord, text: str) -> None:
        told.append(text)
        log.warning("published a line")

    handler = handler_of(log, publish)
    log.info("one")
    await loop_until(lambda: told)
    log.removeHandler(handler)
    handler.close()
    assert told == ["one"]


async def test_repeated_warnings_are_counted_and_the_end_tells_what_waits(
    log: logging.Logger,
) -> None:
    told: list[str] = []
    handler = handler_of(log, lambda record, text: told.append(text))
    for _ in range(WRITTEN + 5):
        log.warning("again")
    log.removeHandler(handler)
    handler.close()
    assert told == [*["again"] * WRITTEN, "repeated 5 times more: again"]
