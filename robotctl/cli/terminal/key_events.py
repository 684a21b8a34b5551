"""The keys that a terminal sends, also their releases, from its bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import Enum
from typing import Final, NamedTuple

MAX_SEQUENCE: Final = 40
"""A longer escape sequence is not waited for."""

MAX_STRING: Final = 4096
MAX_STRING_S: Final = 0.1
"""What is longer, or takes longer, is no string of the terminal: Alt-] may have been pressed."""

ANSWER: Final = "answer"
"""The name of the key that stands for an answer to `CSI ? u`."""

_SEQUENCE = re.compile(r"\x1b(?:\[([?<>=]?)([\d:;]*)|(O))([@-~])")
_BEGUN = re.compile(r"\x1b(?:\[[?<>=]?[\d:;]*|O)?")
_STRING = re.compile(r"\x1b[\]PX^_][^\x07\x1b]*(?:\x07|\x1b\\)")
_STRING_BEGUN = re.compile(r"\x1b[\]PX^_][^\x07\x1b]*\x1b?")
_PASTE, _PASTE_END = "\x1b[200~", "\x1b[201~"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CONTROL_BIT = 4
_SURROGATES_AND_ABOVE = 0xD800
"""No key that is used here has a code this high."""


class KeyEvent(Enum):
    """What happened to a key; a terminal that tells no releases tells repeats as presses."""

    PRESSED = 1
    REPEATED = 2
    RELEASED = 3


class Key(NamedTuple):
    """A key by its character, or `up`, `down`, `left`, `right`, or ANSWER.

    `is_text`: it came in a form for which a terminal tells no release, as pasted text does.
    """

    name: str
    event: KeyEvent = KeyEvent.PRESSED
    with_control: bool = False
    is_text: bool = False


class KeyParser:
    """Turns what is read from a terminal into keys.

    The forms are those of xterm and of the kitty keyboard protocol. What is neither, the strings of
    a terminal (OSC, DCS), and what stands between the marks of a paste, is skipped.
    """

    def __init__(self) -> None:
        self._rest = ""
        self._rest_s = 0.0
        self._is_pasted = False

    def feed(self, text: str, now_s: float) -> Iterator[Key]:
        """Yield the keys of the text, which was read at `now_s`; a sequence may come in parts."""
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
            elif _STRING_BEGUN.fullmatch(text, at) and self._may_end(len(text) - at, now_s):
                self._rest = text[at:]
                return
            else:
                at += 1

    def _may_end(self, length: int, now_s: float) -> bool:
        return length <= MAX_STRING and now_s - self._rest_s <= MAX_STRING_S


def _key(private: str, numbers: str, is_single_shift: str, final: str) -> Iterator[Key]:
    """Yield the key of a sequence, nothing for one that is no key."""
    codes = [part.split(":") for part in numbers.split(";")]
    modifiers, event = 1, KeyEvent.PRESSED
    if len(codes) > 1:
        modifiers = _number(codes[1][0]) or 1
        number = _number(codes[1][1]) if len(codes[1]) > 1 else 1
        event = KeyEvent(number) if number in (2, 3) else event
    with_control = bool((modifiers - 1) & _CONTROL_BIT)
    code = _number(codes[0][0])
    if private:
        if (private, final) == ("?", "u"):
            yield Key(ANSWER)
    elif final in _ARROWS:
        yield Key(_ARROWS[final], event, with_control, is_text=bool(is_single_shift))
    elif final == "u" and 0 < code < _SURROGATES_AND_ABOVE:
        yield Key(chr(code).lower(), event, with_control)


def _number(text: str) -> int:
    return int(text) if text else 0
