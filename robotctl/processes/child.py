"""A child process, as the process that started it sees it."""

from __future__ import annotations

import os
import signal
import time
from typing import Any, Final

from robotctl.processes.descriptors import readable_within, write_whole
from robotctl.processes.report_lines import LineSplitter, decoded

_PIECE_BYTES: Final = 1 << 16
_REAP_POLL_S: Final = 0.01


class Child:
    """A process that `start` has started.

    Use it from one thread. Only `kill` may be called from another thread, but not during `close`.
    """

    def __init__(self, pid: int, reports: int, stdin: int | None) -> None:
        self.pid = pid
        self._reports = reports
        self._stdin = stdin
        self._lines = LineSplitter()
        self._exit_code: int | None = None

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when the child sends a report or ends."""
        return self._reports

    @property
    def has_stdin(self) -> bool:
        """Whether lines can be sent to the process: it has a pipe as stdin, not closed here yet."""
        return self._stdin is not None

    def send(self, line: bytes) -> None:
        """Write a line to its stdin; after `close_stdin`, drop it.

        Raises:
            BrokenPipeError: The child has closed its stdin.
        """
        if self._stdin is not None:
            write_whole(self._stdin, line)

    def close_stdin(self) -> None:
        """Close its stdin, which asks the child to end."""
        if self._stdin is not None:
            os.close(self._stdin)
            self._stdin = None

    def receive(self, seconds: float | None = None) -> list[dict[str, Any]]:
        """Return the next reports; empty if the next line is not complete yet.

        Raises:
            TimeoutError: No data arrived within `seconds`.
            EOFError: The child has closed the pipe.
            ValueError: A line is not a JSON object.
        """
        if seconds is not None and not readable_within(self._reports, seconds):
            raise TimeoutError
        piece = os.read(self._reports, _PIECE_BYTES)
        if not piece:
            raise EOFError
        return [decoded(line) for line in self._lines.feed(piece)]

    def receive_one(self, seconds: float) -> dict[str, Any]:
        """Return the first report.

        Raises:
            TimeoutError: No report arrived within `seconds`.
            EOFError: The child has closed the pipe.
            ValueError: The line is not a JSON object.
        """
        until = time.monotonic() + seconds
        while not (report := self.receive(until - time.monotonic())):
            pass
        return report[0]

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send it a signal, unless its exit code is already known."""
        if self._exit_code is None:
            os.kill(self.pid, number)

    def wait(self, seconds: float) -> int | None:
        """Wait for its exit code: negative for a signal, None if it is still running."""
        until = time.monotonic() + seconds
        while self._exit_code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._exit_code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > until:
                return None
            else:
                time.sleep(_REAP_POLL_S)
        return self._exit_code

    def detach(self) -> None:
        """Close the pipes, and let the process continue."""
        self.close_stdin()
        os.close(self._reports)

    def close(self, patience_s: float = 0.0) -> int:
        """Close the pipes, kill the process after `patience_s`, and return its exit code."""
        self.detach()
        exit_code = self.wait(patience_s)
        while exit_code is None:
            self.kill()
            exit_code = self.wait(patience_s + 1.0)
        return exit_code
