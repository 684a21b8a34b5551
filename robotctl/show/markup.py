"""HTML and SVG as text in which nothing from a recording can become markup."""

from __future__ import annotations

from html import escape
from math import isfinite
from typing import Final

from robotctl.printable import printable

MAX_TEXT: Final = 240
"""The longest text of a recording that is shown, in characters."""

MAX_ESCAPED: Final = 360
"""The longest text on the page, with each special character as up to six."""

_WITHOUT_END: Final = frozenset({"meta", "input", "br"})


class Markup(str):
    """Text that is markup already; every other text is escaped where it is used."""

    __slots__ = ()


Content = str | float | None
"""Markup, a text that will be escaped, a number, or nothing."""


def tag(name: str, /, *content: Content, **attributes: Content) -> Markup:
    """Return an element.

    An attribute is written as `data_t` for `data-t`, `class_` for `class`; one of None is left out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_text(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _WITHOUT_END:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{joined(*content)}</{name}>")


def joined(*content: Content) -> Markup:
    """Return the parts one after the other, those that are no markup escaped."""
    return Markup("".join(map(_text, content)))


def _text(value: Content) -> str:
    if value is None:
        return ""
    if isinstance(value, Markup):
        return value
    if isinstance(value, str):
        text = shown(value)
        written = escape(text)
        if len(written) <= MAX_ESCAPED:
            return written
        return f"{escape(text[: MAX_ESCAPED // len('&quot;') - 1])}…"
    return plain(value)


def shown(text: str) -> str:
    """Return a text of a recording on one line, without control characters, and not too long."""
    line = printable(text[: MAX_TEXT + 1])
    return line if len(line) <= MAX_TEXT else f"{line[: MAX_TEXT - 1]}…"


def plain(value: float) -> str:
    """Return a coordinate for SVG: at most two decimals, never an exponent."""
    if not isfinite(value):
        return "0"
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text
