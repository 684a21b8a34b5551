"""Log lines: escaped, queued, published, and none delays the loop."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from robotctl.base.ros_arguments import LogLevel
from robotctl.daemon.log_lines import (
    CAPACITY,
    CAPACITY_BYTES,
    LINES_PER_TURN,
    WRITTEN,
    LoopHandler,
    PlainFormatter,
)
from robotctl.daemon.ros_logs import MAX_NAME_LENGTH, MAX_NAMES, LoggerLevels
from robotctl.ipc.client import Client
from tests.support.lines import line_of
from tests.support.waiting import DEADLINE_S, loop_until, until
from tests.support.world import World


def formatted(message: str, *arguments: object, failed: bool = False) -> str:
    error = None
    if failed:
        try:
            raise ValueError("why")
        except ValueError:
            error = sys.exc_info()
    record = logging.LogRecord("robotctl", logging.INFO, "", 1, message, arguments, error)
    return PlainFormatter("%(levelname)s: %(message)s").format(record)


def test_a_name_that_steers_a_terminal_or_looks_like_an_entry_is_escaped() -> None:
    assert formatted("topic %s", "/\x1b[2J\r\x07") == r"INFO: topic /\x1b[2J\r\x07"
    assert formatted("Größe %s", "µ") == "INFO: Größe µ"
    assert formatted("in %s", "a\nERROR: forged") == "INFO: in a\n    ERROR: forged"


def test_a_traceback_stays_readable() -> None:
    lines = formatted("it failed", failed=True).split("\n")
    assert lines[:2] == ["INFO: it failed", "Traceback (most recent call last):"]
    assert lines[-1] == "ValueError: why"


LOGGING = """
import ctypes, logging, os, sys, time, warnings
from robotctl.daemon.log_lines import log_to_stderr
log = logging.getLogger("test")
def asked():
    print("asked", flush=True)
    sys.stdin.readline()
with log_to_stderr():
    exec(sys.argv[1])
print("ended", flush=True)
"""


def queued(code: str, stderr: int) -> subprocess.Popen[str]:
    """Log in another process; its stdin and stdout are ours."""
    return subprocess.Popen(
        [sys.executable, "-c", LOGGING, code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )


def full_pipe() -> tuple[int, int]:
    """Both ends of a full pipe without a reader."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for size in (65536, 1):
        try:
            while True:
                os.write(writing, b"-" * size)
        except BlockingIOError:
            pass
    os.set_blocking(writing, True)
    return reading, writing


def read_all(reading: int) -> str:
    with open(reading, "rb") as pipe:
        return pipe.read().decode().replace("-", "")


def test_dropped_lines_are_counted_and_reported_when_stderr_takes_lines_again() -> None:
    reading, writing = full_pipe()
    lines, length = 3000, 1000
    assert lines * length > CAPACITY_BYTES
    code = f"for n in range({lines}): log.warning('%d %s', n, {length} * 'x')\nasked()"
    with queued(code, writing) as process:
        os.close(writing)
        assert process.stdin is not None
        assert line_of(process.stdout) == "asked\n"  # before stderr is read
        process.stdin.write("\n")
        process.stdin.flush()
        text = read_all(reading)
        assert process.wait(DEADLINE_S) == 0
    written = re.findall(rf"^[^ ]+ [^ ]+ WARNING test: (\d+) x{{{length}}}$", text, re.MULTILINE)
    (missing,) = re.findall(r"^log: (\d+) lines are missing here", text, re.MULTILINE)
    assert [int(number) for number in written] == list(range(len(written)))
    assert len(written) + int(missing) == lines
    assert int(missing) > 0


def test_the_end_does_not_wait_for_a_stderr_that_takes_nothing() -> None:
    reading, writing = full_pipe()
    with queued("log.warning('unread')", writing) as process:
        os.close(writing)
        assert line_of(process.stdout) == "ended\n"
        assert process.wait(DEADLINE_S) == 0
    os.close(reading)


def test_what_libraries_and_warnings_write_does_not_wait_either() -> None:
    reading, writing = full_pipe()
    code = "ctypes.CDLL(None).write(2, b'C writes\\n', 9); warnings.warn('late'); asked()"
    with queued(code, writing) as process:
        os.close(writing)
        assert line_of(process.stdout) == "asked\n"
        assert process.stdin is not None
        process.stdin.close()
        text = read_all(reading)
    assert "C writes" in text
    assert "UserWarning: late" in text


def test_all_is_written_in_order_before_the_end() -> None:
    code = "for n in range(2000): log.info('%d', n)\nprint('plain', file=sys.stderr)"
    with queued(code, subprocess.PIPE) as process:
        out, text = process.communicate(timeout=DEADLINE_S)
    *logged, plain = text.splitlines()
    assert [int(line.rpartition(" ")[2]) for line in logged] == list(range(2000))
    assert (plain, out) == ("plain", "ended\n")


def test_a_reader_that_left_ends_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with queued("log.info('one'); time.sleep(0.05); log.info('two')", writing) as process:
        os.close(writing)
        assert process.communicate(timeout=DEADLINE_S)[0] == "ended\n"
    assert process.returncode == 0


def test_a_line_that_repeats_itself_is_written_three_times_and_counted() -> None:
    code = """
for n in range(2000):
    try:
        raise MemoryError
    except MemoryError:
        log.exception("it failed")
    log.info("%d", n)
"""
    with queued(code, subprocess.PIPE) as process:
        _, text = process.communicate(timeout=DEADLINE_S)
    assert text.count("Traceback") == 3
    assert text.count("it failed") == 4
    assert "ERROR test: repeated 1997 times more: it failed\n" in text
    assert text.count(" INFO test: ") == 2000


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


def told_by(log: logging.Logger) -> list[str]:
    """Return a list that grows by each line that is published."""
    told: list[str] = []
    handler_of(log, lambda record, text: told.append(text))
    return told


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


async def test_a_burst_leaves_turns_of_the_loop_to_others(log: logging.Logger) -> None:
    told = told_by(log)
    for number in range(3 * LINES_PER_TURN):
        log.info("%d", number)
    seen = []
    while len(told) < 3 * LINES_PER_TURN:
        await asyncio.sleep(0)
        seen.append(len(told))
    steps = [late - early for early, late in zip([0, *seen], seen, strict=False)]
    assert max(steps) == LINES_PER_TURN


async def test_lines_that_do_not_fit_are_counted_and_told(log: logging.Logger) -> None:
    told = told_by(log)
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


async def test_repeated_warnings_are_counted_and_told_at_the_end(log: logging.Logger) -> None:
    told = told_by(log)
    (handler,) = log.handlers
    for _ in range(WRITTEN + 5):
        log.warning("again")
    log.removeHandler(handler)
    handler.close()
    assert told == [*["again"] * WRITTEN, "repeated 5 times more: again"]


OURS = logging.getLogger("robotctl.daemon.driver")


@pytest.fixture
def levels() -> Iterator[LoggerLevels]:
    """Levels where node `r2.modes` owns the loggers of our modules; they end with the test."""
    root = logging.getLogger()
    before = root.level
    root.setLevel(logging.INFO)
    made = LoggerLevels("r2.modes")
    yield made
    root.setLevel(before)
    for name in made.named:
        logging.getLogger("robotctl" if name == made.own else name or None).setLevel(0)
    root.setLevel(before)


def test_the_node_that_owns_the_log_sets_the_level_of_all_our_modules(levels: LoggerLevels) -> None:
    assert levels.name_of(OURS.name) == "r2.modes"
    assert levels.name_of("asyncio") == "asyncio"
    levels.set("r2.modes", 10, "a test")
    assert OURS.isEnabledFor(logging.DEBUG)
    assert (levels.get("r2.modes"), levels.get("robotctl")) == (10, 10)
    levels.set("r2.modes", 0, "a test")
    assert not OURS.isEnabledFor(logging.DEBUG)


@pytest.mark.parametrize("level", [5, 25, 51, 255])
def test_another_number_is_no_level(levels: LoggerLevels, level: int) -> None:
    assert levels.refusal("robotctl", level) == "Failed reason: Invalid logger level."


def test_callers_cannot_fill_the_memory_with_names(levels: LoggerLevels) -> None:
    for number in range(MAX_NAMES):
        assert levels.refusal(f"made_up.{number}", 10) == ""
        levels.set(f"made_up.{number}", 10, "a test")
    assert "have a level already" in levels.refusal("one.more", 10)
    assert levels.refusal("made_up.0", 20) == ""
    assert "characters" in levels.refusal("x" * (MAX_NAME_LENGTH + 1), 10)


def test_each_change_is_told_also_where_nothing_else_is(
    levels: LoggerLevels, caplog: pytest.LogCaptureFixture
) -> None:
    service = "the ROS service /r2/modes/set_logger_levels"
    levels.set("", 50, service)
    levels.set("", 50, "somebody who changes nothing")
    levels.apply([LogLevel("rcl\x1b", 10), LogLevel("", 20)])
    assert caplog.messages == [
        "log level of all loggers: INFO -> FATAL, by the ROS service /r2/modes/set_logger_levels",
        r"log level of rcl\x1b: UNSET -> DEBUG, by the command line",
        "log level of all loggers: FATAL -> INFO, by the command line",
    ]


STOP_WITHIN_S = 10.0
"""The log stays blocked far longer: however busy the machine is, the stop did not wait for it."""


def count_of(client: Client, topic: str) -> int:
    topics = client.call("status")["topics"]
    return next((int(entry["count"]) for entry in topics if entry["name"] == topic), 0)


def test_a_blocked_log_delays_neither_the_stop_nor_the_zeros(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, writing = full_pipe()
    process = world.spawn("start", "--foreground", "--sim", "--drive", "circle", stderr=writing)
    os.close(writing)
    world.enter(monkeypatch)
    ready = json.loads(line_of(process.stdout))
    assert (ready["ready"], ready["pid"]) == (True, process.pid)
    with Client("robot") as client:
        for number in range(1500):  # more than the queue holds
            client.call("mark", {"text": f"{number} {'x' * 990}", "source": "test"})
        assert client.call("status")["mode"] == "MOVING"
        asked = time.monotonic()
        assert client.call("set_mode", {"mode": 3, "source": "test"})["mode"] == "EMERGENCY_STOP"
        assert time.monotonic() - asked < STOP_WITHIN_S
        sent = count_of(client, "/cmd_vel")
        until(lambda: count_of(client, "/cmd_vel") > sent + 50)
    process.send_signal(signal.SIGINT)
    text = read_all(reading)
    assert process.wait(DEADLINE_S) == 0
    assert re.search(r"^log: \d+ lines are missing here", text, re.MULTILINE)
