"""Fields over time as a PNG file, one below the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO, TYPE_CHECKING, Final

from robotctl.report.axis import Axis, label, label_end
from robotctl.report.field_series import FieldSeries
from robotctl.report.markup import shown
from robotctl.report.time_plot import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, time_axis, value_axis

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

TITLE_HEIGHT: Final = 22
FINE: Final = 2
"""How many pixels the file has for each of the plot."""

INK, SOFT, GRID, LINE = "#1c2430", "#5b6675", "#e8edf2", "#1f6fb2"


def write_fields_png(stream: IO[bytes], fields: Sequence[FieldSeries], duration_s: float) -> None:
    """Write the picture."""
    from PIL import Image, ImageDraw

    height = len(fields) * (HEIGHT + TITLE_HEIGHT)
    canvas = Image.new("RGB", (WIDTH * FINE, height * FINE), "white")
    draw = ImageDraw.Draw(canvas)
    for number, field in enumerate(fields):
        top = number * (HEIGHT + TITLE_HEIGHT)
        _draw_field(draw, field, time_axis(duration_s), top)
    canvas.save(stream, "PNG")


def _draw_field(draw: ImageDraw, field: FieldSeries, time: Axis, top: float) -> None:
    _text(draw, LEFT, top + 4, shown(field.path), INK, "la", 13)
    top += TITLE_HEIGHT
    values = value_axis([field.series], least_span=0.0)
    if values is None:
        return
    for tick in values.ticks(4):
        y = top + values.at(tick)
        _line(draw, [(LEFT, y), (RIGHT, y)], GRID, 1)
        text = label(tick)
        _text(draw, label_end(text, LEFT), y, text, SOFT, "rm", 11)
    for tick in time.ticks(12):
        x = time.at(tick)
        _line(draw, [(x, top + TOP), (x, top + BOTTOM)], GRID, 1)
        _text(draw, x, top + BOTTOM + 6, f"{label(tick)} s", SOFT, "ma", 11)
    for run in field.series.lines():
        _line(draw, [(time.at(t_s), top + values.at(value)) for t_s, value in run], LINE, 1.5)


def _line(draw: ImageDraw, points: list[tuple[float, float]], colour: str, width: float) -> None:
    fine = [(x * FINE, y * FINE) for x, y in points]
    if len(fine) == 1:
        fine.append((fine[0][0] + FINE, fine[0][1]))
    draw.line(fine, fill=colour, width=round(width * FINE), joint="curve")


def _text(
    draw: ImageDraw, x: float, y: float, text: str, colour: str, anchor: str, size: int
) -> None:
    from PIL import ImageFont

    font = ImageFont.load_default(size * FINE)
    draw.text((x * FINE, y * FINE), text, fill=colour, font=font, anchor=anchor)
