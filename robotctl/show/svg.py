"""HTML and SVG: text, elements, and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from math import isfinite
from typing import Final

from robotctl.base.text import printable
from robotctl.show.figure import Figure, Frame, Label, Point, Stroke, laid_out

MAX_TEXT: Final = 240
"""The longest text of a recording that is shown, in characters."""

MAX_ESCAPED: Final = 360
"""The longest text on the page after escaping."""

_WITHOUT_END: Final = frozenset({"meta", "input", "br"})


class Markup(str):
    """Text that is markup already, and is not escaped when it is used."""

    __slots__ = ()


Content = str | float | None
"""Markup, a text that will be escaped, a number, or nothing."""


def tag(name: str, /, *content: Content, **attributes: Content) -> Markup:
    """Return an element of HTML or SVG, with text escaped.

    Write `data_t` for the attribute `data-t`, and `class_` for `class`. None omits an attribute.
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
    """Join the parts into one piece of markup, with text escaped."""
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
    """Return `text` as one line of at most MAX_TEXT characters, without control characters."""
    line = printable(text[: MAX_TEXT + 1])
    return line if len(line) <= MAX_TEXT else f"{line[: MAX_TEXT - 1]}…"


def plain(value: float) -> str:
    """Return a coordinate for SVG, with at most two decimals and no exponent."""
    if not isfinite(value):
        return "0"
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


TIME_FRAME: Final = Frame(960, 132, 62, 948, 10, 112)
"""The frame of all figures over time on a page."""

TITLE_HEIGHT: Final = 22
BASELINE_PX: Final = 4
"""The distance from the middle of a text down to its baseline."""

_STYLE: Final = """
svg{background:#fff}text{font:11.5px system-ui,"DejaVu Sans",sans-serif;fill:#5b6675}
text.title{font-weight:600;font-size:13px;fill:#1c2430}.grid{stroke:#e8edf2;fill:none}
.line{fill:none;stroke:#1f6fb2;stroke-width:1.6;stroke-linejoin:round;stroke-linecap:round}
.value{text-anchor:end}.tick{text-anchor:middle}.tick.last{text-anchor:end}
"""


def drawing(
    figure: Figure, frame: Frame, *over: Content, class_: str = "", **attributes: Content
) -> Markup:
    """Return a figure as an `<svg>` element, with the elements `over` drawn above it."""
    return tag(
        "svg",
        *map(element, laid_out(figure, frame)),
        *over,
        viewBox=f"0 0 {frame.width} {plain(frame.height)}",
        class_=class_ or None,
        **attributes,
    )


def figures_svg(figures: Sequence[Figure]) -> str:
    """Return the text of an SVG file with figures over time, one below the other."""
    width, step, pieces = TIME_FRAME.width, TIME_FRAME.height + TITLE_HEIGHT, []
    for number, figure in enumerate(figures):
        top = number * step
        pieces += [
            tag("text", figure.title, x=TIME_FRAME.left, y=top + 16, class_="title"),
            drawing(
                figure, TIME_FRAME, y=top + TITLE_HEIGHT, width=width, height=TIME_FRAME.height
            ),
        ]
    height = len(figures) * step
    return tag(
        "svg",
        tag("style", Markup(_STYLE)),
        *pieces,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width} {height}",
        width=width,
        height=height,
    )


def element(piece: Stroke | Label) -> Markup:
    """Return a part of a figure, a line or a text, as an SVG element."""
    if isinstance(piece, Label):
        kind = "tick last" if piece.kind == "tick" and piece.is_end else piece.kind
        return tag("text", piece.text, x=piece.x, y=piece.y + BASELINE_PX, class_=kind)
    kind = piece.kind if piece.kind == "grid" else f"line {piece.kind}"
    return tag("path", d=_path_data(piece.runs), class_=kind)


def _path_data(runs: Iterable[Sequence[Point]]) -> Markup:
    parts = []
    for run in runs:
        points = [f"{plain(x)} {plain(y)}" for x, y in run]
        if len(points) == 1:
            points *= 2  # a line without length: its round ends draw a dot
        parts.append(f"M{'L'.join(points)}")
    return Markup("".join(parts))
