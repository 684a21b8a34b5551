"""A process that is started early is a copy of the command, or a new one where it has to be."""

from __future__ import annotations

import os
import sys
import textwrap
import threading
from pathlib import Path

import pytest

from robotctl.cli.support.early_process import early_or_new, started_early
from tests.support.waiting import until

TELLING = """
import os
import sys
from robotctl.processes import report_fd, send_report

def main(arguments):
    line = os.read(0, 100)
    os.write(1, b"on stdout")
    send_report(report_fd(arguments), {"pid": os.getpid(), "said": line.decode()})
    os.read(0, 1)
    return 7

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def telling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that reports its pid and the line that it gets, and writes to stdout."""
    package = tmp_path / "telling"
    package.mkdir()
    package.joinpath("__init__.py").touch()
    package.joinpath("__main__.py").write_text(textwrap.dedent(TELLING))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "telling"


def command_of(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def ask(module: str) -> bytes:
    """Ask a process that was started early; return its command line."""
    with started_early(module):
        child = early_or_new(module)
        child.send(b"hello\n")
        report = child.receive_one(60.0)
        command = command_of(child.pid)
        assert report == {"pid": child.pid, "said": "hello\n"}
        assert child.close(10.0) == 7
    return command


def test_it_is_a_copy_of_this_process_and_writes_nothing_to_stdout(
    telling: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.cli.support.early_process.has_one_thread", lambda: True)
    assert ask(telling) == command_of(os.getpid())
    assert capfd.readouterr() == ("", "on stdout")


def test_it_is_a_new_process_where_others_threads_hold_locks(
    telling: str, capfd: pytest.CaptureFixture[str]
) -> None:
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    try:
        command = ask(telling)
    finally:
        end.set()
        thread.join()
    assert command.startswith(os.fsencode(f"{sys.executable}\0-P\0-m\0{telling}\0"))
    assert capfd.readouterr() == ("", "on stdout")


def test_it_is_a_new_process_where_another_ros_was_sourced(
    telling: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "ros" / "lib" / "librcl.so"
    library.parent.mkdir(parents=True)
    library.touch()
    paths = f"{library.parent}:{os.environ.get('LD_LIBRARY_PATH', '')}"
    monkeypatch.setenv("LD_LIBRARY_PATH", paths)
    monkeypatch.setattr("robotctl.cli.support.early_process.has_one_thread", lambda: True)
    assert b"\0-m\0telling\0" in ask(telling)


def test_a_copy_ends_with_the_command_that_started_it(
    telling: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.cli.support.early_process.has_one_thread", lambda: True)
    with started_early(telling):
        child = early_or_new(telling)
        child.close_stdin()  # as the end of this process would
        until(lambda: child.wait(0.0) is not None)
        child.close()
