"""Values over time in a terminal, one field below the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robotctl.cli.terminal.braille_canvas import DOTS_ACROSS, DOTS_DOWN, BrailleCanvas
from robotctl.cli.terminal.text import elided
from robotctl.report.axis import Axis, axis_for, least_span_of
from robotctl.report.field_series import FieldSeries

LABEL = 11
LEAST_ROWS = 4
LINES_BESIDE = 2
"""The lines of a field beside its rows: its name, and the time axis."""

_COLOUR, _PLAIN = "\x1b[36m", "\x1b[0m"


def field_lines(
    fields: Sequence[FieldSeries],
    duration_s: float,
    *,
    width: int,
    height: int,
    colour: bool,
    ascii_only: bool,
) -> Iterator[str]:
    """Yield the lines of the pictures; they fit `width`, and `height` where that is possible."""
    rows = max(height // max(len(fields), 1) - LINES_BESIDE, LEAST_ROWS)
    across = max(width - LABEL - 1, 10)
    for field in fields:
        yield elided(f"{'':{LABEL}} {field.path}  {_range(field)}", width)
        if field.series.count:
            yield from _picture(field, duration_s, across, rows, colour, ascii_only)


def _range(field: FieldSeries) -> str:
    series = field.series
    if series.least is None or series.most is None:
        return "no values"
    return f"{series.least:.6g} to {series.most:.6g}, {series.count} values"


def _label(value: float) -> str:
    """Return a number with as many of five digits as have room beside the axis."""
    texts = (f"{value:.{digits}g}" for digits in range(5, 0, -1))
    return next(text for text in texts if len(text) < LABEL)


def _picture(
    field: FieldSeries, duration_s: float, across: int, rows: int, colour: bool, ascii_only: bool
) -> Iterator[str]:
    low, high = field.series.least or 0.0, field.series.most or 0.0
    dots_down = rows * DOTS_DOWN - 1
    values = axis_for(low, high, dots_down, 0, least_span=least_span_of(low, high))
    time = Axis(0.0, max(duration_s, 1e-3), 0, across * DOTS_ACROSS - 1)
    canvas = BrailleCanvas()
    for run in field.series.lines():
        canvas.line([(round(time.at(t_s)), round(values.at(value))) for t_s, value in run])
    for row in range(rows):
        label = {0: _label(values.high), rows - 1: _label(values.low)}.get(row, "")
        drawn = "".join(
            canvas.character(column, row, ascii_only=ascii_only) for column in range(across)
        ).rstrip()
        coloured = f"{_COLOUR}{drawn}{_PLAIN}" if colour and drawn else drawn
        yield f"{label:>{LABEL - 1}} {'|' if ascii_only else '│'}{coloured}"
    end = f"{duration_s:.2f} s"
    rule = ("-" if ascii_only else "─") * (across - len(end) - 4)
    yield f"{'':{LABEL}}{'+' if ascii_only else '└'} 0 {rule} {end}"
