"""The keys of a terminal: presses, releases and pasted text; checks that the terminal answers."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from enum import Enum
from types import FrameType
from typing import Any, Final, NamedTuple, Self

from robotctl.cli.ui.text import is_terminal

_LOCAL_FLAGS = 3
"""The index of the local flags in the list that tcgetattr returns."""


class Keyboard:
    """A context in which keys arrive one by one and without echo.

    Ctrl-Z takes effect in `read`: it calls `suspend` before the process stops, and `resume` when it
    continues. Without a terminal, or in the background of a shell, there are no keys.
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
                signal.SIGCONT: signal.signal(signal.SIGCONT, lambda *_: self._take()),
            }
            self._take()  # again on SIGCONT: until then, the process may be in the background
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
        """The file descriptors to wait for: keys, and Ctrl-Z. Empty without a terminal."""
        keys = [] if self._saved is None else [self._file]
        return keys if self._stop_asked < 0 else [*keys, self._stop_asked]

    @property
    def keys_from(self) -> int:
        """The file descriptor to read keys from, or -1 if this process gets no keys."""
        return -1 if self._saved is None else self._file

    def read(self) -> str:
        """Return the pressed keys as text, or "" if there are none. It never waits for a key."""
        ready, _, _ = select.select(self.sources, [], [], 0.0)
        if self._stop_asked in ready:
            os.eventfd_read(self._stop_asked)
            self._stop()
        return os.read(self._file, 64).decode(errors="ignore") if self._file in ready else ""

    def has_ended(self, ready: Sequence[object]) -> bool:
        """Return whether the terminal is closed. Call this only if `read` has just returned "".

        `ready` has those of the `sources` that were readable before `read` was called.
        """
        return self._saved is not None and self._file in ready and self._stop_asked not in ready

    def flush(self) -> None:
        """Drop the keys that are not read yet."""
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


MAX_SEQUENCE: Final = 40
"""The maximum length of an unfinished escape sequence [characters]; a longer one is dropped."""

MAX_STRING: Final = 4096
MAX_STRING_S: Final = 0.1
"""Limits on an OSC or DCS string [characters, s]; beyond them, it was a key such as Alt-]."""

ANSWER: Final = "answer"
"""The `Key.name` of a terminal's answer to the query `CSI ? u`."""

_SEQUENCE = re.compile(r"\x1b(?:\[([?<>=]?)([\d:;]*)|(O))([@-~])")
_BEGUN = re.compile(r"\x1b(?:\[[?<>=]?[\d:;]*|O)?")
_STRING = re.compile(r"\x1b[\]PX^_][^\x07\x1b]*(?:\x07|\x1b\\)")
_STRING_BEGUN = re.compile(r"\x1b[\]PX^_][^\x07\x1b]*\x1b?")
_PASTE, _PASTE_END = "\x1b[200~", "\x1b[201~"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CONTROL_BIT = 4
_SURROGATES_AND_ABOVE = 0xD800
"""Keys with this code or a higher one are ignored."""


class KeyEvent(Enum):
    """A change of a key's state; some terminals send repeats as presses, and no releases."""

    PRESSED = 1
    REPEATED = 2
    RELEASED = 3


class Key(NamedTuple):
    """A key event. `name` is a character, an arrow (`up`, `down`, `left`, `right`) or ANSWER.

    ANSWER is no key: the terminal has answered a query. `is_text` is True if no release of the key
    will follow, as for pasted text.
    """

    name: str
    event: KeyEvent = KeyEvent.PRESSED
    with_control: bool = False
    is_text: bool = False


class KeyParser:
    """Turns the text from a terminal into keys.

    Only sequences of xterm and of the kitty keyboard protocol become keys. Text pasted between the
    marks of bracketed paste is skipped.
    """

    def __init__(self) -> None:
        self._rest = ""
        self._rest_s = 0.0
        self._is_pasted = False

    def feed(self, text: str, now_s: float) -> Iterator[Key]:
        """Yield the keys in `text`, read at `now_s`; the next text may continue a sequence."""
        if not self._rest:
            self._rest_s = now_s
        text, self._rest = self._rest + text, ""
        at = 0
        while at < len(text):
            if self._is_pasted:
                end = text.find(_PASTE_END, at)
                if end < 0:
                    self._rest = text[max(at, len(text) - len(_PASTE_END) + 1) :]
                    return
                self._is_pasted, at = False, end + len(_PASTE_END)
            elif text[at] != "\x1b":
                yield Key(text[at].lower(), is_text=True)
                at += 1
            elif text.startswith(_PASTE, at):
                self._is_pasted, at = True, at + len(_PASTE)
            elif string := _STRING.match(text, at):
                at = string.end()
            elif found := _SEQUENCE.match(text, at):
                yield from _key(*found.groups(default=""))
                at = found.end()
            elif _BEGUN.fullmatch(text, at):
                self._rest = text[at:] if len(text) - at <= MAX_SEQUENCE else ""
                return
            elif (
                len(text) - at <= MAX_STRING
                and now_s - self._rest_s <= MAX_STRING_S
                and _STRING_BEGUN.fullmatch(text, at)
            ):
                self._rest = text[at:]
                return
            else:
                at += 1


def _key(private: str, numbers: str, is_single_shift: str, final: str) -> Iterator[Key]:
    """Yield the key of an escape sequence with these parts, if there is one."""
    codes = [part.split(":") for part in numbers.split(";")]
    modifiers, event = 1, KeyEvent.PRESSED
    if len(codes) > 1:
        modifiers = int(codes[1][0] or 0) or 1
        number = int(codes[1][1] or 0) if len(codes[1]) > 1 else 1
        event = KeyEvent(number) if number in (2, 3) else event
    with_control = bool((modifiers - 1) & _CONTROL_BIT)
    code = int(codes[0][0] or 0)
    if private:
        if (private, final) == ("?", "u"):
            yield Key(ANSWER)
    elif final in _ARROWS:
        yield Key(_ARROWS[final], event, with_control, is_text=bool(is_single_shift))
    elif final == "u" and 0 < code < _SURROGATES_AND_ABOVE:
        yield Key(chr(code).lower(), event, with_control)


ANSWER_S: Final = 0.3
"""The timeout of a terminal's answer [s]; a slower terminal is used without releases."""

_ASK: Final = b"\x1b[?u\x1b[c"
"""Asks for the keyboard flags, then for the type of the terminal."""

_BEGIN: Final = b"\x1b[>11u"
"""Push flags: unambiguous codes (1), events (2), for all keys (8)."""

_END: Final = b"\x1b[<u"

_MARK_PASTES: Final = b"\x1b[?2004h"
_MARK_NO_PASTES: Final = b"\x1b[?2004l"
"""Switch the marks of pastes on and off."""

_IS_KNOWN: Final = re.compile(rb"\x1b\[\?\d+u")
_IS_ANSWERED: Final = re.compile(rb"\x1b\[\?[\d;]*c")


class ReleaseEvents:
    """A context in which the terminal reports key releases and marks pasted text.

    `told` is False if the terminal reports no releases. Use this inside a `Keyboard` context.
    """

    def __init__(self, keys_from: int, drawn_on: int) -> None:
        """Read answers from the descriptor `keys_from` (-1: no keys), and write to `drawn_on`."""
        self._keys_from = keys_from
        self._drawn_on = drawn_on
        self.told = False

    def __enter__(self) -> Self:
        """Switch on paste marks, and release events if the terminal reports them."""
        if self._keys_from >= 0:
            self.told = self._can_tell()
            self.resume()
        return self

    def __exit__(self, *_: object) -> None:
        """Switch off release events and paste marks."""
        self.suspend()

    def suspend(self) -> None:
        """Switch off release events and paste marks, for another program."""
        if self._keys_from >= 0:
            self._write((_END if self.told else b"") + _MARK_NO_PASTES)

    def resume(self) -> None:
        """Switch on paste marks, and release events if the terminal reports them."""
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


ASK_EACH_S: Final = 0.025
"""The minimum time between questions [s]: a fifth of MAX_SILENCE_S."""

_ASK_FLAGS: Final = b"\x1b[?u"
"""Asks for the keyboard flags."""


class TerminalAnswers:
    """A context to query the terminal in; `KeyParser` yields each answer as a key named ANSWER."""

    def __init__(self) -> None:
        self._file = -1
        self._asked_s = float("-inf")

    def __enter__(self) -> Self:
        """Open the controlling terminal."""
        # A descriptor of its own, non-blocking: a terminal that accepts no data delays no key.
        self._file = os.open("/dev/tty", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        return self

    def __exit__(self, *_: object) -> None:
        """Close the terminal's descriptor."""
        os.close(self._file)

    def ask(self) -> None:
        """Query the terminal, unless the last query was less than ASK_EACH_S ago."""
        now_s = time.monotonic()
        if now_s - self._asked_s >= ASK_EACH_S:
            self._asked_s = now_s
            with suppress(OSError):  # the terminal accepts nothing now, or is gone: no answer comes
                os.write(self._file, _ASK_FLAGS)
