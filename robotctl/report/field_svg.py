"""Fields over time as an SVG file, one below the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from robotctl.report.field_series import FieldSeries
from robotctl.report.markup import Markup, tag
from robotctl.report.time_plot import HEIGHT, LEFT, WIDTH, Plot, PlotLine, plot_svg, time_axis

TITLE_HEIGHT: Final = 22
STYLE: Final = """
svg{background:#fff}text{font:11.5px system-ui,"DejaVu Sans",sans-serif;fill:#5b6675}
text.title{font-weight:600;font-size:13px;fill:#1c2430}.grid{stroke:#e8edf2;fill:none}
.line{fill:none;stroke:#1f6fb2;stroke-width:1.6;stroke-linejoin:round;stroke-linecap:round}
.value{text-anchor:end}.tick{text-anchor:middle}.tick.last{text-anchor:end}.cursor{display:none}
"""


def fields_svg(fields: Sequence[FieldSeries], duration_s: float) -> str:
    """Return the text of the file."""
    axis, pieces = time_axis(duration_s), []
    for number, field in enumerate(fields):
        top = number * (HEIGHT + TITLE_HEIGHT)
        plot = Plot(field.path, "", (PlotLine(field.series, field.path, "command"),), 0.0)
        pieces.append(tag("text", field.path, x=LEFT, y=top + 16, class_="title"))
        drawn = plot_svg(plot, axis, number, y=top + TITLE_HEIGHT, width=WIDTH, height=HEIGHT)
        if drawn is not None:
            pieces.append(drawn)
    height = len(fields) * (HEIGHT + TITLE_HEIGHT)
    return tag(
        "svg",
        tag("style", Markup(STYLE)),
        *pieces,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {WIDTH} {height}",
        width=WIDTH,
        height=height,
    )
