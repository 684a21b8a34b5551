"""Read single keys from the terminal, and restore its settings in every case."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, Self

from robotctl.cli.terminal.text import is_terminal

_LOCAL_FLAGS = 3
"""The index of the local flags in the list that tcgetattr returns."""


class Keyboard:
    """A context in which keys arrive one by one and without echo; Ctrl-C and Ctrl-Z still work.

    Ctrl-Z takes effect in `read`, never while something is drawn: `suspend` is called before the
    process stops, and `resume` when it continues. Without a terminal, and in the background of a
    shell, there are no keys.
    """

    def __init__(self, suspend: Callable[[], object], resume: Callable[[], object]) -> None:
        self._suspend = suspend
        self._resume = resume
        self._stop_asked = -1
        self._file = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._saved: list[Any] | None = None
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        """Turn off echo and line mode, and handle Ctrl-Z."""
        if self._file >= 0 and is_terminal():
            self._stop_asked = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            self._previous = {
                signal.SIGTSTP: signal.signal(signal.SIGTSTP, self._ask_to_stop),
                signal.SIGCONT: signal.signal(signal.SIGCONT, self._go_on),
            }
            self._take()
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the settings and the signal handlers."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._give_back()
        if self._stop_asked >= 0:
            os.close(self._stop_asked)
            self._stop_asked = -1

    @property
    def sources(self) -> list[int]:
        """The descriptors to wait for: keys and Ctrl-Z; empty without a terminal."""
        keys = [] if self._saved is None else [self._file]
        return keys if self._stop_asked < 0 else [*keys, self._stop_asked]

    @property
    def keys_from(self) -> int:
        """The descriptor of the keys alone, -1 without a terminal."""
        return -1 if self._saved is None else self._file

    def read(self) -> str:
        """Return the keys that were pressed; call it when one of `sources` is readable."""
        ready, _, _ = select.select(self.sources, [], [], 0.0)
        if self._stop_asked in ready:
            os.eventfd_read(self._stop_asked)
            self._stop()
        return os.read(self._file, 64).decode(errors="ignore") if self._file in ready else ""

    def has_ended(self, ready: Sequence[object]) -> bool:
        """Return whether the terminal was readable without a key, so that none will come."""
        return self._saved is not None and self._file in ready and self._stop_asked not in ready

    def flush(self) -> None:
        """Drop the keys that were pressed and not read."""
        if self._saved is not None:
            termios.tcflush(self._file, termios.TCIFLUSH)

    def _take(self) -> None:
        if self._saved is None and self._is_in_foreground():
            self._saved = termios.tcgetattr(self._file)
            unseen = termios.tcgetattr(self._file)
            unseen[_LOCAL_FLAGS] &= ~(termios.ICANON | termios.ECHO)
            termios.tcsetattr(self._file, termios.TCSADRAIN, unseen)

    def _is_in_foreground(self) -> bool:
        try:
            return os.tcgetpgrp(self._file) == os.getpgrp()
        except OSError:  # it is not the controlling terminal
            return False

    def _give_back(self) -> None:
        if self._saved is not None:
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._saved)
            self._saved = None

    def _ask_to_stop(self, number: int, frame: FrameType | None) -> None:
        os.eventfd_write(self._stop_asked, 1)

    def _stop(self) -> None:
        self._suspend()
        self._give_back()
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)  # returns when the shell continues the process
        signal.signal(signal.SIGTSTP, self._ask_to_stop)
        self._take()
        self._resume()

    def _go_on(self, number: int, frame: FrameType | None) -> None:
        self._take()  # it may have run in the background until now
