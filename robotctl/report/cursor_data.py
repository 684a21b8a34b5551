"""What the script of a page needs to move its cursor: times, pixels and values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from robotctl.report.axis import Axis
from robotctl.report.driven import DrivenPlace
from robotctl.report.path_plot import Ground
from robotctl.report.time_plot import Plot, PlotLine, plot_id
from robotctl.report.traces import ModeSpan

MAX_PLACES: Final = 1000


def cursor_data(
    axis: Axis,
    plots: Sequence[Plot],
    modes: Sequence[ModeSpan],
    places: Sequence[DrivenPlace],
    ground: Ground | None,
) -> dict[str, object]:
    """Return the data for plots on this time axis; `places` are shown on `ground`."""
    return {
        "begin": axis.begin,
        "end": axis.end,
        "duration": axis.high,
        "modes": [[round(span.begin_s, 3), span.mode] for span in modes],
        "places": [] if ground is None else _places(places, ground),
        "values": {
            plot_id(number): [{"name": line.name, "points": _points(line)} for line in plot.lines]
            for number, plot in enumerate(plots, 1)
        },
    }


def _places(places: Sequence[DrivenPlace], ground: Ground) -> list[list[float]]:
    return [
        [round(place.t_s, 2), round(ground.x.at(place.x), 1), round(ground.y.at(place.y), 1)]
        for place in places[:: max(len(places) // MAX_PLACES, 1)]
    ]


def _points(line: PlotLine) -> list[list[float]]:
    return [[round(column.end_s, 3), float(f"{column.last:.4g}")] for column in line.series.columns]
