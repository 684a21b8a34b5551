"""The keys that a terminal sends, also their releases, from its bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

MAX_SEQUENCE = 40
"""A longer escape sequence is not waited for."""

_SEQUENCE = re.compile(r"\x1b(?:\[([?<>=]?)([\d:;]*)|O)([@-~])")
_BEGUN = re.compile(r"\x1b(?:\[[?<>=]?[\d:;]*|O)?")
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
    """A key by its character, or `up`, `down`, `left`, `right`."""

    name: str
    event: KeyEvent = KeyEvent.PRESSED
    with_control: bool = False


class KeyParser:
    """Turns what is read from a terminal into keys.

    The forms are those of xterm and of the kitty keyboard protocol; what is neither is skipped.
    """

    def __init__(self) -> None:
        self._rest = ""

    def feed(self, text: str) -> Iterator[Key]:
        """Yield the keys of the text; a sequence may come in parts."""
        text, self._rest = self._rest + text, ""
        at = 0
        while at < len(text):
            if text[at] != "\x1b":
                yield Key(text[at].lower())
                at += 1
            elif found := _SEQUENCE.match(text, at):
                yield from _key(*found.groups(default=""))
                at = found.end()
            elif (begun := _BEGUN.match(text, at)) and begun.end() == len(text):
                self._rest = text[at:] if len(text) - at <= MAX_SEQUENCE else ""
                return
            else:
                at += 1


def _key(private: str, numbers: str, final: str) -> Iterator[Key]:
    """Yield the key of a sequence, nothing for one that is no key, such as an answer."""
    codes = [part.split(":") for part in numbers.split(";")]
    modifiers, event = 1, KeyEvent.PRESSED
    if len(codes) > 1:
        modifiers = _number(codes[1][0]) or 1
        number = _number(codes[1][1]) if len(codes[1]) > 1 else 1
        event = KeyEvent(number) if number in (2, 3) else event
    with_control = bool((modifiers - 1) & _CONTROL_BIT)
    code = _number(codes[0][0])
    if private:
        return
    if final in _ARROWS:
        yield Key(_ARROWS[final], event, with_control)
    elif final == "u" and 0 < code < _SURROGATES_AND_ABOVE:
        yield Key(chr(code).lower(), event, with_control)


def _number(text: str) -> int:
    return int(text) if text else 0
