"""Asks a terminal for signs of life, without ever waiting for it."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from typing import Final, Self

ASK_EACH_S: Final = 0.025
"""Five times in the longest silence of one who drives by hand."""

_ASK: Final = b"\x1b[?u"
"""Which keyboard flags are set: only a terminal that can tell releases answers."""


class TerminalAnswers:
    """A context in which a terminal can be asked; `KeyParser` yields its answers as ANSWER.

    The question goes through a descriptor of its own that does not block, so that a terminal that
    takes nothing delays no key.
    """

    def __init__(self) -> None:
        self._file = -1
        self._asked_s = float("-inf")

    def __enter__(self) -> Self:
        """Open the controlling terminal."""
        self._file = os.open("/dev/tty", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        os.close(self._file)

    def ask(self) -> None:
        """Ask, if the last question is ASK_EACH_S old."""
        now_s = time.monotonic()
        if now_s - self._asked_s >= ASK_EACH_S:
            self._asked_s = now_s
            with suppress(OSError):  # it takes nothing now, or is gone: then no answer comes
                os.write(self._file, _ASK)
