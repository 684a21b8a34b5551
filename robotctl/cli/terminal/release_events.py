"""Asks a terminal to mark pastes, and for the releases of keys (kitty keyboard protocol)."""

from __future__ import annotations

import os
import re
import select
import time
from contextlib import suppress
from typing import Final, Self

ANSWER_S: Final = 0.3
"""How long a terminal may take to answer; one that answers later tells no releases here."""

_ASK: Final = b"\x1b[?u\x1b[c"
"""Which keyboard flags are set, then which terminal it is: every terminal answers the latter."""

_BEGIN: Final = b"\x1b[>11u"
"""Push flags: unambiguous codes (1), events (2), for all keys (8)."""

_END: Final = b"\x1b[<u"

_MARK_PASTES: Final = b"\x1b[?2004h"
_MARK_NO_PASTES: Final = b"\x1b[?2004l"
"""A terminal that cannot mark them ignores both."""

_IS_KNOWN: Final = re.compile(rb"\x1b\[\?\d+u")
_IS_ANSWERED: Final = re.compile(rb"\x1b\[\?[\d;]*c")


class ReleaseEvents:
    """A context in which the terminal tells releases of keys, if it can: then `told` is true.

    It also marks what is pasted, if it can. Keys must arrive one by one (`Keyboard`). `suspend` and
    `resume` enclose the time in which another program uses the terminal.
    """

    def __init__(self, keys_from: int, drawn_on: int) -> None:
        """Take the descriptors of the terminal's input and output; -1 for none."""
        self._keys_from = keys_from
        self._drawn_on = drawn_on
        self.told = False

    def __enter__(self) -> Self:
        """Ask the terminal, and begin if it can."""
        if self._keys_from >= 0:
            self.told = self._can_tell()
            self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.suspend()

    def suspend(self) -> None:
        """Let the terminal send keys and pastes as before."""
        if self._keys_from >= 0:
            self._write((_END if self.told else b"") + _MARK_NO_PASTES)

    def resume(self) -> None:
        """Let the terminal tell releases and mark pastes again."""
        if self._keys_from >= 0:
            self._write((_BEGIN if self.told else b"") + _MARK_PASTES)

    def _can_tell(self) -> bool:
        self._write(_ASK)
        answer, end = b"", time.monotonic() + ANSWER_S
        while not _IS_ANSWERED.search(answer) and (left_s := end - time.monotonic()) > 0.0:
            if select.select([self._keys_from], [], [], left_s)[0]:
                data = os.read(self._keys_from, 256)
                if not data:
                    break
                answer += data
        return _IS_KNOWN.search(answer) is not None

    def _write(self, data: bytes) -> None:
        with suppress(OSError):  # the terminal may be gone
            os.write(self._drawn_on, data)
