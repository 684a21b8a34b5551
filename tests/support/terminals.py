"""Command lines that run on a pseudo-terminal."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import sys
import termios
import time
from collections.abc import Mapping
from contextlib import suppress

from tests.support.waiting import DEADLINE_S

ECHO_FLAGS = 3
CODE = "from robotctl.cli.app import main; main()"


class Terminal:
    """A command line on a pseudo-terminal; `seen` is what it has drawn since the last `until`."""

    def __init__(
        self,
        *arguments: object,
        program: tuple[str, ...] = (CODE,),
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        command = [sys.executable, "-c", *program, *map(str, arguments)]
        environment = {**environment, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        self.pid, self._file = pty.fork()
        if self.pid == 0:
            for number in (signal.SIGINT, signal.SIGQUIT):  # a job in the background ignores them
                signal.signal(number, signal.SIG_DFL)
            os.execve(command[0], command, environment)
        self.seen = ""

    def until(self, text: str, again: str = "") -> str:
        """Wait until the regular expression `text` is drawn; return what was drawn before it.

        Keys in `again` are pressed each second: on a busy machine, held keys may count as released.
        """
        begin = pressed = time.monotonic()
        while not (found := re.search(text, self.seen)):
            now = time.monotonic()
            assert now < begin + DEADLINE_S, self.seen[-2000:]
            if again and now > pressed + 1.0:
                self.press(again)
                pressed = now
            self._read(0.1)
        before, self.seen = self.seen[: found.start()], self.seen[found.end() :]
        return before

    def press(self, keys: str) -> None:
        os.write(self._file, keys.encode())

    def is_cooked(self) -> bool:
        """Return whether the terminal echoes and delivers whole lines, as at the start."""
        flags = termios.tcgetattr(self._file)[ECHO_FLAGS]
        return bool(flags & termios.ECHO) and bool(flags & termios.ICANON)

    def end(self) -> int:
        """Wait for the process, and return its exit code."""
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            pid, found = os.waitpid(self.pid, os.WNOHANG)
            while self._read(0.0 if pid else 0.05):  # its output must go somewhere
                pass
            if pid:
                return os.waitstatus_to_exitcode(found)
        raise AssertionError("the process did not end")

    def _read(self, seconds: float) -> bool:
        """Read what is drawn within `seconds`; return whether anything was drawn."""
        drawn = b""
        if self._file < 0:  # the terminal is hung up
            time.sleep(seconds)
            return False
        with suppress(OSError):  # the process has ended
            if select.select([self._file], [], [], seconds)[0]:
                drawn = os.read(self._file, 65536)
        self.seen += drawn.decode(errors="replace")
        return bool(drawn)

    def hang_up(self) -> None:
        """Close the terminal, as when its window is closed."""
        os.close(self._file)
        self._file = -1

    def close(self) -> None:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        if self._file >= 0:
            os.close(self._file)
