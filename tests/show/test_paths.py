"""The picture shows every path to scale."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from robotctl.show.figure import Path2D, path_figure
from robotctl.show.png import write_path_png
from robotctl.show.terminal import ground_lines

SQUARE: Path2D = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
NAN = float("nan")


def braille(
    reference: Path2D, driven: Path2D, *, rows: int = 18, colour: bool = False
) -> list[str]:
    return ground_lines(path_figure(reference, driven), rows=rows, colour=colour)


def write_png(file: Path, reference: Path2D, driven: Path2D, title: str) -> None:
    write_path_png(file, path_figure(reference, driven, title))


def dots(lines: list[str]) -> int:
    """Return the number of braille dots."""
    return sum(
        (ord(c) - 0x2800).bit_count() for line in lines for c in line if "\u2800" <= c < "\u2900"
    )


def test_a_square_is_as_high_as_it_is_wide() -> None:
    *rows, axis, numbers = braille([], SQUARE, rows=10)
    assert rows[0].startswith("   1.00 \u2502")
    assert rows[-1].startswith("   0.00 \u2502")
    assert " ".join(numbers.split()) == "0.00 1.00 m a dot is 26 mm"
    columns = axis.count("\u2500")
    assert columns * 2 == len(rows) * 4  # dots


def test_the_driven_path_lies_over_the_wanted_one() -> None:
    away = [(2.0, 0.0), (2.0, 1.0)]
    wanted, driven, both = (
        dots(braille(*paths)) for paths in ((SQUARE, away), (away, SQUARE), (SQUARE, SQUARE))
    )
    assert wanted < driven  # the wanted path is dotted
    assert both == dots(braille([], SQUARE))


def test_the_square_is_drawn_where_it_is() -> None:
    assert braille([], SQUARE, rows=3)[:3] == [
        "   1.00 \u2502\u284f\u2809\u2809\u2809\u2809\u28b9",
        "        \u2502\u2847    \u28b8",
        "   0.00 \u2502\u28c7\u28c0\u28c0\u28c0\u28c0\u28f8",
    ]


@pytest.mark.parametrize(
    "path",
    [
        [],
        [(0.0, 0.0)],
        [(1.0, 2.0)] * 5,
        [(0.0, 0.0), (1000.0, 0.0)],
        [(0.0, 0.0), (0.0, 1e-9)],
        [(0.0, 0.0), (NAN, 1.0), (1.0, math.inf), (1.0, 1.0)],
    ],
)
def test_every_path_can_be_drawn(path: Path2D, tmp_path: Path) -> None:
    lines = braille(path, path)
    assert all(len(line) <= 80 for line in lines)
    assert dots(lines) > 0 or not path
    write_png(tmp_path / "path.png", path, path, "any")
    assert (tmp_path / "path.png").stat().st_size > 1000


def test_colour_tells_the_paths_apart_and_changes_nothing_else() -> None:
    coloured = "\n".join(braille(SQUARE, [(0.5, 0.5), (0.6, 0.6)], colour=True))
    plain = "\n".join(braille(SQUARE, [(0.5, 0.5), (0.6, 0.6)]))
    assert "\x1b[32m" in coloured
    assert "\x1b[34m" in coloured
    for code in ("\x1b[32m", "\x1b[34m", "\x1b[0m"):
        coloured = coloured.replace(code, "")
    assert coloured == plain


def test_the_png_is_a_square_with_both_paths_in_it(tmp_path: Path) -> None:
    from PIL import Image

    write_png(tmp_path / "path.png", SQUARE, [(0.5, 0.0), (0.5, 1.0)], "a title")
    with Image.open(tmp_path / "path.png") as image:
        assert image.size == (800, 800)
        pixels: Any = image.load()
        red, green, blue = pixels[400, 400]
        edge, corner = pixels[400, 103], pixels[5, 5]
    assert (red > 200, green < 100, blue < 60) == (True, True, True)
    assert edge != corner == (255, 255, 255)


def test_what_is_not_finite_is_left_out() -> None:
    figure = path_figure([], [(0.0, 1.0), (NAN, NAN), (2.0, 3.0)])
    assert (figure.x, figure.y) == ((0.0, 2.0), (1.0, 3.0))
