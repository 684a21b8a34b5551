"""Figures as a PNG file, one below the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from robotctl.recording.format.disk import replaced_file
from robotctl.show.figure import Figure, Frame, Label, Point, laid_out
from robotctl.show.svg import TIME_FRAME, TITLE_HEIGHT, shown

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

TIME_FINE: Final = 2.0
"""Pixels of the file per pixel of the frame of a figure over time."""

PATH_FRAME: Final = Frame(500, 500 - TITLE_HEIGHT, 50, 450, 28, 428)
PATH_FINE: Final = 1.6

SMOOTH: Final = 2
"""A figure is drawn this many times larger than in the file, to smooth its lines."""

LEGEND_PX: Final = 80

INK, SOFT = "#1c2430", "#5b6675"
STYLES: Final = {
    "grid": ("#e8edf2", 1.0),
    "command": ("#1f6fb2", 1.5),
    "wanted": ("#9db8d9", 3.75),
    "driven": ("#d1481f", 1.5),
}
"""Colour and width of each kind of line."""


def write_path_png(file: Path, figure: Figure) -> None:
    """Write a map of paths on the ground to a PNG file, which is replaced if it exists.

    Raises:
        OSError: The file cannot be written.
    """
    with replaced_file(file) as stream:
        write_png(stream, [figure], PATH_FRAME, PATH_FINE)


def write_png(
    stream: IO[bytes],
    figures: Sequence[Figure],
    frame: Frame = TIME_FRAME,
    fine: float = TIME_FINE,
) -> None:
    """Write the figures into one PNG, with `fine` pixels of the file per pixel of `frame`."""
    from PIL import Image, ImageDraw

    step = frame.height + TITLE_HEIGHT
    size = round(frame.width * fine), round(len(figures) * step * fine)
    canvas = Image.new("RGB", (size[0] * SMOOTH, size[1] * SMOOTH), "white")
    for number, figure in enumerate(figures):
        pen = _Pen(ImageDraw.Draw(canvas), fine * SMOOTH, number * step)
        pen.title(figure, frame)
        pen.figure(figure, frame)
    canvas.resize(size, Image.Resampling.LANCZOS).save(stream, "PNG")


class _Pen:
    """Draws one figure below `top`, in coordinates of its frame."""

    def __init__(self, draw: ImageDraw, scale: float, top: float) -> None:
        self._draw = draw
        self._scale = scale
        self._top = top

    def title(self, figure: Figure, frame: Frame) -> None:
        """Write the title, and the names of lines to its right."""
        self._text(shown(figure.title), frame.left, 4, INK, "la", 13)
        named = [line for line in figure.lines if line.name]
        for place, line in enumerate(named):
            x, y = frame.right - LEGEND_PX * (len(named) - place), TITLE_HEIGHT + 12
            self._line([(x, y), (x + 16, y)], line.kind)
            self._text(line.name, x + 20, y, SOFT, "lm", 11)

    def figure(self, figure: Figure, frame: Frame) -> None:
        """Draw a figure below its title."""
        for each in laid_out(figure, frame):
            if isinstance(each, Label):
                y, anchor = each.y + TITLE_HEIGHT, "rm" if each.is_end else "mm"
                self._text(each.text, each.x, y, SOFT, anchor, 11)
            else:
                for run in each.runs:
                    self._line([(x, y + TITLE_HEIGHT) for x, y in run], each.kind)

    def _line(self, points: Sequence[Point], kind: str) -> None:
        fine = [(x * self._scale, (self._top + y) * self._scale) for x, y in points]
        if len(fine) == 1:
            fine.append((fine[0][0] + self._scale, fine[0][1]))
        colour, width = STYLES[kind]
        self._draw.line(fine, fill=colour, width=round(width * self._scale), joint="curve")

    def _text(self, text: str, x: float, y: float, colour: str, anchor: str, size: int) -> None:
        from PIL import ImageFont

        font = ImageFont.load_default(size * self._scale)
        at = (x * self._scale, (self._top + y) * self._scale)
        self._draw.text(at, text, fill=colour, font=font, anchor=anchor)
