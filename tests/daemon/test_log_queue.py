"""Logging never waits for stderr; lines that it does not take are counted and reported."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable

import pytest

from robotctl.daemon.log.lines import CAPACITY_BYTES
from tests.support.waiting import DEADLINE_S

LOGGING = """
import ctypes, logging, os, sys, time, warnings
from robotctl.daemon.log.lines import log_to_stderr
log = logging.getLogger("test")
def asked():
    print("asked", flush=True)
    sys.stdin.readline()
with log_to_stderr():
    exec(sys.argv[1])
print("ended", flush=True)
"""

Run = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def run() -> Run:
    """Log in another process; its stdin and stdout are ours."""

    def started(code: str, stderr: int) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", LOGGING, code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )

    return started


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


def test_dropped_lines_are_counted_and_reported_when_stderr_takes_lines_again(run: Run) -> None:
    reading, writing = full_pipe()
    lines, length = 3000, 1000
    assert lines * length > CAPACITY_BYTES
    code = f"for n in range({lines}): log.warning('%d %s', n, {length} * 'x')\nasked()"
    with run(code, writing) as process:
        os.close(writing)
        assert process.stdout is not None
        assert process.stdin is not None
        assert process.stdout.readline() == "asked\n"  # before stderr is read
        process.stdin.write("\n")
        process.stdin.flush()
        text = read_all(reading)
        assert process.wait(DEADLINE_S) == 0
    written = re.findall(rf"^[^ ]+ [^ ]+ WARNING test: (\d+) x{{{length}}}$", text, re.MULTILINE)
    (missing,) = re.findall(r"^log: (\d+) lines are missing here", text, re.MULTILINE)
    assert [int(number) for number in written] == list(range(len(written)))
    assert len(written) + int(missing) == lines
    assert int(missing) > 0


def test_the_end_does_not_wait_for_a_stderr_that_takes_nothing(run: Run) -> None:
    reading, writing = full_pipe()
    with run("log.warning('unread')", writing) as process:
        os.close(writing)
        assert process.stdout is not None
        assert process.stdout.readline() == "ended\n"
        assert process.wait(DEADLINE_S) == 0
    os.close(reading)


def test_what_libraries_and_warnings_write_does_not_wait_either(run: Run) -> None:
    reading, writing = full_pipe()
    code = "ctypes.CDLL(None).write(2, b'C writes\\n', 9); warnings.warn('late'); asked()"
    with run(code, writing) as process:
        os.close(writing)
        assert process.stdout is not None
        assert process.stdout.readline() == "asked\n"
        assert process.stdin is not None
        process.stdin.close()
        text = read_all(reading)
    assert "C writes" in text
    assert "UserWarning: late" in text


def test_all_is_written_in_order_before_the_end(run: Run) -> None:
    code = "for n in range(2000): log.info('%d', n)\nprint('plain', file=sys.stderr)"
    with run(code, subprocess.PIPE) as process:
        out, text = process.communicate(timeout=DEADLINE_S)
    *logged, plain = text.splitlines()
    assert [int(line.rpartition(" ")[2]) for line in logged] == list(range(2000))
    assert (plain, out) == ("plain", "ended\n")


def test_a_reader_that_left_ends_nothing(run: Run) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with run("log.info('one'); time.sleep(0.05); log.info('two')", writing) as process:
        os.close(writing)
        assert process.communicate(timeout=DEADLINE_S)[0] == "ended\n"
    assert process.returncode == 0


def test_a_line_that_repeats_itself_is_written_three_times_and_counted(run: Run) -> None:
    code = """
for n in range(2000):
    try:
        raise MemoryError
    except MemoryError:
        log.exception("it failed")
    log.info("%d", n)
"""
    with run(code, subprocess.PIPE) as process:
        _, text = process.communicate(timeout=DEADLINE_S)
    assert text.count("Traceback") == 3
    assert text.count("it failed") == 4
    assert "ERROR test: repeated 1997 times more: it failed\n" in text
    assert text.count(" INFO test: ") == 2000
