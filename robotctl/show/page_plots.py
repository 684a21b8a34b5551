"""The plots of a report page, and the data for the script that moves their cursor."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from robotctl.show.figure import (
    GROUND_ROOM,
    Axis,
    Figure,
    Frame,
    Line,
    Point,
    ground_figure,
    time_figure,
    x_ticks,
)
from robotctl.show.series import DrivenPlace, Series
from robotctl.show.svg import BASELINE_PX, TIME_FRAME, Markup, drawing, element, plain, tag
from robotctl.show.traces import ModeSpan, TracedMoment, Traces

BAND_FRAME: Final = Frame(960, 72, 62, 948, 24, 50)

PATH_WIDTH: Final = 640
MARGIN_LEFT, MARGIN_TOP, MARGIN = 58, 14, 34
MIN_HEIGHT, MAX_HEIGHT = 200, 640

CHARACTER_PX: Final = 7.2
"""The approximate width of a character in a plot."""

NUMBER_PX: Final = 15.0
"""The least distance between the numbers of two moments."""

LEAST_SPEED, LEAST_ERROR_M = 0.05, 0.01
LEAST_BATTERY_PERCENT, LEAST_LATE_MS = 2.0, 2.0
"""The y axis of a plot spans at least this, so that small noise does not fill the plot."""

MAX_PLACES: Final = 1000


@dataclass(frozen=True, slots=True)
class TimePlot:
    """A plot over time. `series` has the values, the legend name and the style of each line."""

    title: str
    unit: str
    series: tuple[tuple[Series, str, str], ...]
    least_span: float
    from_zero: bool = False

    def figure(self, duration_s: float) -> Figure:
        """Return the plot as a figure, without lines if no series has a value."""
        lines = (Line(list(each.lines()), kind, name) for each, name, kind in self.series)
        return time_figure(
            f"{self.title} [{self.unit}]",
            lines,
            duration_s,
            least_span=self.least_span,
            from_zero=self.from_zero,
        )


def plots_of(traces: Traces) -> list[TimePlot]:
    """Return the plots over time: speed, turn rate, tracking error, battery, tick lateness."""
    speeds = (
        (traces.commanded_linear, "command", "command"),
        (traces.linear, "measured", "driven"),
    )
    turns = (
        (traces.commanded_angular, "command", "command"),
        (traces.angular, "measured", "driven"),
    )
    off, level = ((traces.error, "", "error"),), ((traces.battery, "", "battery"),)
    late = ((traces.lateness, "", "late"),)
    return [
        TimePlot("Speed", "m/s", speeds, LEAST_SPEED),
        TimePlot("Turn rate", "rad/s", turns, LEAST_SPEED),
        TimePlot("Off track", "m", off, LEAST_ERROR_M, from_zero=True),
        TimePlot("Battery", "%", level, LEAST_BATTERY_PERCENT),
        TimePlot("Tick later than planned", "ms", late, LEAST_LATE_MS),
    ]


def time_plots(traces: Traces) -> Iterator[Markup]:
    """Yield a time bar of modes and events, then a captioned picture of each plot with values."""
    if traces.modes or traces.moments:
        yield _mode_band(traces)
    for number, plot in enumerate(plots_of(traces), 1):
        figure = plot.figure(traces.duration_s)
        if figure.lines:
            cursor = _cursor(TIME_FRAME.top, TIME_FRAME.bottom)
            told = {"aria_label": f"{plot.title} over time", "id": _plot_id(number)}
            picture = drawing(figure, TIME_FRAME, cursor, class_="time", role="img", **told)
            yield _captioned(figure, picture)


def path_plot(traces: Traces) -> Markup | None:
    """Return a map of the driven and reference paths with a legend, or None without any path."""
    figure, places = _path_figure(traces), traces.driven.whole()
    if not figure.lines:
        return None
    legend = [tag("span", "driven, by odometry", class_="key driven")]
    if traces.wanted:
        legend.append(tag("span", "wanted", class_="key wanted"))
    frame = _path_frame(figure)
    picture = drawing(
        figure,
        frame,
        *_marks(places, traces.moments, *figure.axes(frame)),
        class_="path",
        role="img",
        aria_label="the driven path over the wanted one",
        id="plot-path",
    )
    return tag("figure", tag("figcaption", *legend), picture)


def cursor_data(traces: Traces) -> dict[str, object]:
    """Return the JSON object with the times, pixels and values that the page's cursor needs."""
    time, _ = time_figure("", (), traces.duration_s).axes(TIME_FRAME)
    figure, places = _path_figure(traces), traces.driven.whole()
    x, y = figure.axes(_path_frame(figure))
    return {
        "begin": time.begin,
        "end": time.end,
        "duration": time.high,
        "modes": [[round(span.begin_s, 3), span.mode] for span in traces.modes],
        "places": [
            [round(place.t_s, 2), round(x.at(place.x), 1), round(y.at(place.y), 1)]
            for place in places[:: max(len(places) // MAX_PLACES, 1)]
        ],
        "values": {
            _plot_id(number): [
                {
                    "name": name,
                    "points": [
                        [round(column.end_s, 3), float(f"{column.last:.4g}")]
                        for column in series.columns
                    ],
                }
                for series, name, _ in plot.series
            ]
            for number, plot in enumerate(plots_of(traces), 1)
        },
    }


def _plot_id(number: int) -> str:
    return f"plot-{number}"


def _captioned(figure: Figure, picture: Markup) -> Markup:
    entries = [
        tag("span", line.name, class_=f"key {line.kind}") for line in figure.lines if line.name
    ]
    head = tag("figcaption", tag("b", figure.title), *entries, tag("output", "", class_="now"))
    return tag("figure", head, tag("div", picture, class_="scroll"))


def _cursor(top: float, bottom: float) -> Markup:
    return tag("path", d=f"M0 {top}V{bottom}", class_="cursor")


def _path_figure(traces: Traces) -> Figure:
    driven: list[Point] = [(place.x, place.y) for place in traces.driven.whole()]
    lines = [Line([outline], "wanted") for outline in traces.wanted]
    if driven:
        lines.append(Line([driven], "driven"))
    return ground_figure("", lines)


def _path_frame(figure: Figure) -> Frame:
    """Return a frame of the usual width, as high as the paths need."""
    right = PATH_WIDTH - MARGIN
    tall = Frame(PATH_WIDTH, MAX_HEIGHT, MARGIN_LEFT, right, MARGIN_TOP, MAX_HEIGHT - MARGIN)
    _, y = figure.axes(tall)
    low, high = figure.y
    needed = (high - low) * GROUND_ROOM * abs(y.scale) + MARGIN_TOP + MARGIN
    height = min(max(needed, MIN_HEIGHT), MAX_HEIGHT)
    return Frame(PATH_WIDTH, height, MARGIN_LEFT, right, MARGIN_TOP, height - MARGIN)


def _marks(
    places: Sequence[DrivenPlace], moments: Sequence[TracedMoment], x: Axis, y: Axis
) -> Iterator[Markup]:
    """Yield marks on the path for the moments, the two ends and the cursor."""
    if not places:
        return
    for number, moment in enumerate(moments, 1):
        index = bisect_right(places, moment.t_s, key=lambda place: place.t_s) - 1
        place = places[max(index, 0)]
        yield tag(
            "g",
            tag("title", f"{number}. {moment.t_s:.2f} s, {moment.kind}"),
            tag("circle", cx=x.at(place.x), cy=y.at(place.y), r=3.5, class_="flag"),
            class_="moment",
            data_t=f"{moment.t_s:.4f}",
        )
    for place, name in ((places[0], "begin"), (places[-1], "end")):
        circle = tag("circle", cx=x.at(place.x), cy=y.at(place.y), r=5, class_=f"place {name}")
        yield tag("g", tag("title", name), circle)
    yield tag("circle", r=6, cx=0, cy=0, class_="cursor")


def _mode_band(traces: Traces) -> Markup:
    """Return a band of the modes over time, below the marks of the moments."""
    frame = BAND_FRAME
    figure = time_figure("Mode, and what happened", (), traces.duration_s)
    time, _ = figure.axes(frame)
    pieces = [_mode(span, time) for span in traces.modes]
    named_to = -NUMBER_PX
    for number, moment in enumerate(traces.moments, 1):
        has_room = time.at(moment.t_s) - named_to >= NUMBER_PX
        named_to = time.at(moment.t_s) if has_room else named_to
        pieces.append(_mark(number, moment, time.at(moment.t_s), has_room=has_room))
    picture = drawing(
        figure,
        frame,
        *pieces,
        *map(element, x_ticks(figure, frame)),
        _cursor(frame.top - 4, frame.bottom),
        class_="time band",
        role="img",
        aria_label="modes and moments over time",
        id="plot-modes",
    )
    return _captioned(figure, picture)


def _mode(span: ModeSpan, time: Axis) -> Markup:
    top, height = BAND_FRAME.top, BAND_FRAME.bottom - BAND_FRAME.top
    begin = time.at(span.begin_s)
    width = max(time.at(span.end_s) - begin, 0.75)
    name = span.mode.replace("_", " ")
    told = f"{span.mode} from {span.begin_s:.2f} s to {span.end_s:.2f} s: {span.reason}"
    text = None
    if width > len(name) * CHARACTER_PX + 8:
        middle = top + height / 2 + BASELINE_PX
        text = tag("text", name, x=begin + 6, y=middle, class_="mode-name")
    box = tag("rect", x=begin, y=top, width=width, height=height, class_=f"mode {span.mode}")
    return tag("g", tag("title", told), box, text)


def _mark(number: int, moment: TracedMoment, at: float, *, has_room: bool) -> Markup:
    top, bottom = BAND_FRAME.top, BAND_FRAME.bottom
    return tag(
        "g",
        tag("title", f"{number}. {moment.t_s:.2f} s, {moment.kind}: {moment.text}"),
        tag("path", d=f"M{plain(at)} {plain(top)}l-5 -9h10z", class_="flag"),
        tag("path", d=f"M{plain(at)} {plain(top)}V{plain(bottom)}", class_="flag-line"),
        tag("text", str(number), x=at, y=top - 12, class_="flag-number") if has_room else None,
        id=f"moment-{number}",
        class_="moment",
        data_t=f"{moment.t_s:.4f}",
    )
