"""Child processes report through their own pipe, independent of what libraries print.

The reports of a child are heard without ever blocking the loop.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Timer
from typing import Any

import pytest

import robotctl
from robotctl.base.jobs import job_command, reports_of, run_job
from robotctl.base.processes import Child, LineSplitter, program, readable_within, start
from robotctl.config import RecordingParams
from robotctl.daemon.recording.black_box import BlackBox
from robotctl.daemon.recording.housekeeping import TIDY
from robotctl.recording import read_info
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.keep.repair import TidyJob
from robotctl.recording.keep.retention import RetentionPolicy
from robotctl.testing.drives import drive, record
from tests.support.bags import talk, write_bag
from tests.support.cases import for_each
from tests.support.lines import Ran, run_program
from tests.support.waiting import DEADLINE_S

ROBOTCTL = (sys.executable, "-c", "from robotctl.cli.app import main; main()")

SAY = """
import os, sys
sys.path.insert(0, os.getcwd())
from robotctl.base.processes import send_report, report_fd
fd = report_fd(sys.argv)
"""

NOISE = """
import os, sys

class Noise:
    def find_spec(self, name, path=None, target=None):
        if name == "rclpy":
            say()

def say():
    for fd in (1, 2):
        os.write(fd, b'[RTPS_TRANSPORT_SHM Error] Failed fastrtps_port7412\\n{{"x": 1}}\\n')

sys.meta_path.insert(0, Noise())
if any(name in sys.orig_argv for name in {modules}):
    say()
"""
"""Prints as Fast DDS does, before the process reports, and also lines that look like reports."""

JOBS = "robotctl.base.jobs"


@contextmanager
def child(code: str, *arguments: str, **options: object) -> Iterator[Child]:
    command = [sys.executable, "-c", SAY + code, *arguments]
    process = start(command, **options)  # type: ignore[arg-type]
    try:
        yield process
    finally:
        with suppress(OSError):
            process.close()


def all_of(process: Child) -> list[dict[str, Any]]:
    """Return all reports until the process ends."""
    heard: list[dict[str, Any]] = []
    with suppress(EOFError):
        while True:
            heard += process.receive(DEADLINE_S)
    return heard


@pytest.fixture
def noisy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let each child print to stdout and stderr when it starts, or imports rclpy; return the folder
    for it.
    """
    modules = [JOBS]
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(NOISE.format(modules=modules))
    known = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{folder}:{known}" if known else str(folder))
    return tmp_path


def test_a_replay_whose_libraries_print_is_heard_and_its_output_is_one_object(
    noisy: Path, domain_id: int
) -> None:
    file = write_bag(noisy / "run.mcap", talk("/alpha", 3))
    ran = run_program(*ROBOTCTL, "replay", file, "--json", "--domain-id", domain_id)
    ran.succeeded()
    assert ran.summary["sent"] == 3
    assert ran.err.count("fastrtps_port7412") == 2  # nothing that a library says is lost


async def test_a_clip_whose_process_prints_is_heard(
    noisy: Path, caplog: pytest.LogCaptureFixture
) -> None:
    recording = record(noisy / "run", drive(1.0))
    caplog.set_level("INFO")
    box = BlackBox(RecordingParams(clip_before_s=1.0, clip_after_s=0.0), recording)
    box.note(RecordedEvent(EventKind.ERROR, read_info(recording).start_ns, "because"))
    await box.finish()
    assert f"clip of the error: {recording / 'clips'}" in caplog.text


def test_reports_arrive_complete_and_in_order() -> None:
    code = "for n in range(3): send_report(fd, {'n': n, 'x': 'y' * 300_000})"
    with child(code) as process:
        heard = all_of(process)
        assert [(each["n"], len(each["x"])) for each in heard] == [(n, 300_000) for n in range(3)]
        assert process.close(DEADLINE_S) == 0


def test_a_child_reads_lines_until_its_stdin_is_closed() -> None:
    with child(
        "for line in sys.stdin: send_report(fd, {'told': line})", with_stdin=True
    ) as process:
        process.send(b"a\n")
        process.send(b"b\n")
        process.close_stdin()
        assert not process.has_stdin
        process.send(b"too late\n")
        assert all_of(process) == [{"told": "a\n"}, {"told": "b\n"}]


def test_silence_is_given_up_at_the_deadline() -> None:
    with child("sys.stdin.read()", with_stdin=True) as process:
        with pytest.raises(TimeoutError):
            process.receive_one(0.05)
        assert process.wait(0.0) is None


@for_each("line", ["not json", "[1]", '"text"'])
def test_what_is_no_object_is_an_error(line: str) -> None:
    with child(f"os.write(fd, {line!r}.encode() + b'\\n')") as process, pytest.raises(ValueError):  # noqa: PT011
        process.receive_one(DEADLINE_S)


@for_each("position", [0, 1])
def test_the_end_of_one_child_is_seen_while_another_runs(position: int) -> None:
    wait = "send_report(fd, {})\nsys.stdin.read()"
    with child(wait, with_stdin=True) as first, child(wait, with_stdin=True) as second:
        children = [first, second]
        for each in children:
            assert each.receive_one(DEADLINE_S) == {}
        children[position].close_stdin()
        with pytest.raises(EOFError):
            children[position].receive(DEADLINE_S)
        assert children[1 - position].wait(0.0) is None


def test_the_end_of_a_child_is_seen_while_a_grandchild_runs() -> None:
    code = (
        "import subprocess\n"
        "send_report(fd, {'pid': subprocess.Popen(['sleep', '600'], close_fds=False).pid})"
    )
    with child(code) as process:
        pid = process.receive_one(DEADLINE_S)["pid"]
        try:
            with pytest.raises(EOFError):
                process.receive(DEADLINE_S)
        finally:
            os.kill(pid, signal.SIGKILL)


def test_a_child_that_does_not_leave_is_killed() -> None:
    with child(
        "import time\nsend_report(fd, {})\nwhile True: time.sleep(600)", with_stdin=True
    ) as process:
        process.receive_one(DEADLINE_S)
        assert process.close(0.05) == -signal.SIGKILL


def test_a_child_has_a_process_group_and_default_signals_of_its_own() -> None:
    code = (
        "import signal\n"
        "send_report(fd, {'group': os.getpgrp(), 'session': os.getsid(0), 'pid': os.getpid(),"
        " 'blocked': [int(n) for n in signal.pthread_sigmask(signal.SIG_BLOCK, [])]})"
    )
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    try:
        with child(code) as process:
            said = process.receive_one(DEADLINE_S)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    assert said["group"] == said["pid"] == process.pid
    assert said["session"] == os.getsid(0)
    assert said["blocked"] == []


def test_with_a_log_a_child_has_its_own_session_and_writes_there(tmp_path: Path) -> None:
    code = (
        "print('printed', flush=True)\nos.write(2, b'complained')\n"
        "send_report(fd, {'s': os.getsid(0)})"
    )
    with child(code, log=tmp_path / "log") as process:
        assert process.receive_one(DEADLINE_S) == {"s": process.pid}
        process.close(DEADLINE_S)
    assert (tmp_path / "log").read_text() == "printed\ncomplained"
    assert (tmp_path / "log").stat().st_mode & 0o077 == 0


def test_a_child_that_outlives_us_inherits_no_descriptor_of_our_caller(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    try:
        os.set_inheritable(writing, True)
        with child(
            "send_report(fd, {})\nos.read(0, 1)", log=tmp_path / "log", with_stdin=True
        ) as process:
            os.close(writing)
            writing = -1
            process.receive_one(DEADLINE_S)
            assert readable_within(reading, 0), "the child holds the other end"
    finally:
        os.close(reading)
        if writing >= 0:
            os.close(writing)


def test_a_program_that_was_started_without_stdin_stdout_and_stderr_starts_children() -> None:
    code = (
        "import os, sys\n"
        "for fd in (0, 1, 2): os.close(fd)\n"
        "from robotctl.base.processes import start\n"
        "script = 'from robotctl.base.processes import send_report, report_fd; import sys;'\n"
        "script += 'sys.stdin.read(); send_report(report_fd(sys.argv), {})'\n"
        "child = start([sys.executable, '-c', script], with_stdin=True)\n"
        "child.close_stdin()\n"
        "raise SystemExit(7 if child.receive_one(30.0) == {} else 1)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=2 * DEADLINE_S).returncode == 7


def test_a_program_that_cannot_be_started_leaves_no_descriptor_behind() -> None:
    before = os.listdir("/proc/self/fd")
    with pytest.raises(FileNotFoundError):
        start(["/nowhere/python"], with_stdin=True)
    assert os.listdir("/proc/self/fd") == before


def test_a_child_that_is_started_by_hand_reports_it() -> None:
    said = "this is started by robotctl, with --report-fd\n"
    assert run_program(*program(JOBS), "{}") == Ran(1, "", said)


def test_lines_come_out_of_pieces() -> None:
    lines = LineSplitter()
    assert [lines.feed(piece) for piece in (b"a", b"b\nc\n", b"", b"d\n")] == [
        [],
        [b"ab", b"c"],
        [],
        [b"d"],
    ]


def test_every_child_is_started_in_one_way() -> None:
    from robotctl.cli.commands.recordings import replay_play
    from robotctl.cli.targets import launch

    player = program(replay_play.PLAYER)
    programs = (launch.DAEMON, player, job_command("module:function", {}))
    assert all(each[:3] == (sys.executable, "-P", "-m") for each in programs)
    root = Path(robotctl.__file__).parent
    cli = root / "cli"  # what is foreign runs programs that are not ours
    foreign = [cli / "commands" / "boot.py", cli / "commands" / "lease.py"]
    for path in root.rglob("*.py"):
        if path not in [*foreign, root / "base" / "processes.py"]:
            text = path.read_text(encoding="utf-8")
            assert "import subprocess" not in text, path
            assert "posix_spawn" not in text, path
            assert "os.fork" not in text, path


async def test_a_job_works_in_a_folder_whose_name_is_not_utf_8(tmp_path: Path) -> None:
    recordings = tmp_path / os.fsdecode(b"recordings\xff")
    recording = record(recordings / "one", drive(0.5))
    job = TidyJob(recordings, RetentionPolicy(max_bytes=0), repairs=False)
    notes = await run_job(job_command(TIDY, job))
    assert [each["removed"] for each in notes] == [str(recording / "one_0.mcap")]


async def test_a_child_that_lives_on_after_a_report_does_not_hold_up_the_loop() -> None:
    reading, writing = os.pipe()
    closed_by: list[str] = []

    def close(by: str) -> None:
        if not closed_by:
            closed_by.append(by)
            os.close(writing)

    guard = Timer(5.0, close, ["the guard"])  # ends a read that blocks
    guard.start()
    asyncio.get_running_loop().call_later(0.1, close, "the loop")
    os.write(writing, b'{"text": "first"}\n')
    child = Child(os.getpid(), reading, None)
    try:
        assert [said async for said in reports_of(child)] == [{"text": "first"}]
    finally:
        guard.cancel()
        child.detach()
    assert closed_by == ["the loop"]
