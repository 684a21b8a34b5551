"""Values over time as SVG; all plots of a page share the same time axis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from robotctl.report.axis import Axis, axis_for, label, label_end, least_span_of
from robotctl.report.markup import Content, Markup, plain, tag
from robotctl.report.series import Sample, Series
from robotctl.report.traces import ModeSpan, TracedMoment

WIDTH: Final = 960
LEFT: Final = 62
RIGHT: Final = 948
HEIGHT: Final = 132
TOP, BOTTOM = 10, 112
BAND_HEIGHT: Final = 70
BAND_TOP, BAND_BOTTOM = 24, 50
CHARACTER_PX: Final = 7.2
"""The width of a character in a plot, about."""

NUMBER_PX: Final = 15.0
"""How far apart the numbers of moments are, at least."""

LEAST_SPEED, LEAST_ERROR_M = 0.05, 0.01
"""The least height of a plot of speeds [m/s, rad/s] or distances: noise is shown small."""


@dataclass(frozen=True, slots=True)
class PlotLine:
    """A line of a plot: its name in the legend, and the class of its colour."""

    series: Series
    name: str
    colour: str


def time_axis(duration_s: float) -> Axis:
    """Return the time axis of every plot."""
    return Axis(0.0, max(duration_s, 1e-3), LEFT, RIGHT)


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot over time: its lines, and the least height of its values, which may begin at 0."""

    title: str
    unit: str
    lines: tuple[PlotLine, ...]
    least_span: float
    from_zero: bool = False


def plot_id(number: int) -> str:
    """Return the id of a plot on its page."""
    return f"plot-{number}"


def time_plot(plot: Plot, time: Axis, number: int) -> Markup | None:
    """Return a plot with its caption, None if no line has a value."""
    drawn = plot_svg(plot, time, number, class_="time", role="img")
    if drawn is None:
        return None
    named = [line for line in plot.lines if line.name and line.series.count]
    return _figure(
        f"{plot.title} [{plot.unit}]", [(line.name, line.colour) for line in named], drawn
    )


def plot_svg(plot: Plot, time: Axis, number: int, **attributes: Content) -> Markup | None:
    """Return the picture of a plot with further attributes, None if no line has a value."""
    lines = [line for line in plot.lines if line.series.count]
    values = value_axis([line.series for line in lines], plot.least_span, plot.from_zero)
    if values is None:
        return None
    drawn = [
        tag("path", d=path_data(line.series.lines(), time, values), class_=f"line {line.colour}")
        for line in lines
    ]
    return tag(
        "svg",
        *_grid(time, values),
        *drawn,
        _cursor(TOP, BOTTOM),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        aria_label=f"{plot.title} over time",
        id=plot_id(number),
        **attributes,
    )


def value_axis(series: Sequence[Series], least_span: float, from_zero: bool = False) -> Axis | None:
    """Return the axis of the values of a plot, None without a value."""
    lows = [each.least for each in series if each.least is not None]
    highs = [each.most for each in series if each.most is not None]
    if not lows:
        return None
    low, high = 0.0 if from_zero else min(lows), max(highs)
    least_span = max(least_span, least_span_of(low, high))
    axis = axis_for(low, high, BOTTOM, TOP, least_span=least_span)
    return Axis(0.0, axis.high, BOTTOM, TOP) if from_zero else axis


def mode_band(spans: Sequence[ModeSpan], moments: Sequence[TracedMoment], time: Axis) -> Markup:
    """Return the modes over time, and a mark with the number of each moment above them."""
    pieces = [_mode(span, time) for span in spans]
    named_to = -NUMBER_PX
    for number, moment in enumerate(moments, 1):
        has_room = time.at(moment.t_s) - named_to >= NUMBER_PX
        named_to = time.at(moment.t_s) if has_room else named_to
        pieces.append(_mark(number, moment, time, has_room=has_room))
    axis = Axis(0.0, 1.0, BAND_BOTTOM, BAND_TOP)
    return _figure(
        "Mode, and what happened",
        [],
        tag(
            "svg",
            *pieces,
            *_time_labels(time, axis, BAND_HEIGHT),
            _cursor(BAND_TOP - 4, BAND_BOTTOM),
            viewBox=f"0 0 {WIDTH} {BAND_HEIGHT + 2}",
            class_="time band",
            role="img",
            aria_label="modes and moments over time",
            id="plot-modes",
        ),
    )


def _mode(span: ModeSpan, time: Axis) -> Markup:
    begin = time.at(span.begin_s)
    width = max(time.at(span.end_s) - begin, 0.75)
    name = span.mode.replace("_", " ")
    told = f"{span.mode} from {span.begin_s:.2f} s to {span.end_s:.2f} s: {span.reason}"
    text = None
    if width > len(name) * CHARACTER_PX + 8:
        middle = (BAND_TOP + BAND_BOTTOM) / 2 + 4
        text = tag("text", name, x=begin + 6, y=middle, class_="mode-name")
    height = BAND_BOTTOM - BAND_TOP
    box = tag("rect", x=begin, y=BAND_TOP, width=width, height=height, class_=f"mode {span.mode}")
    return tag("g", tag("title", told), box, text)


def path_data(lines: Iterable[Sequence[Sample]], time: Axis, values: Axis) -> Markup:
    """Return the `d` of an SVG path through the points of each line."""
    parts = []
    for line in lines:
        points = [f"{plain(time.at(t))} {plain(values.at(value))}" for t, value in line]
        if len(points) == 1:
            points *= 2  # a dot, by its round end
        parts.append(f"M{'L'.join(points)}")
    return Markup("".join(parts))


def _mark(number: int, moment: TracedMoment, time: Axis, *, has_room: bool) -> Markup:
    at = time.at(moment.t_s)
    return tag(
        "g",
        tag("title", f"{number}. {moment.t_s:.2f} s, {moment.kind}: {moment.text}"),
        tag("path", d=f"M{plain(at)} {BAND_TOP}l-5 -9h10z", class_="flag"),
        tag("path", d=f"M{plain(at)} {BAND_TOP}V{BAND_BOTTOM}", class_="flag-line"),
        tag("text", str(number), x=at, y=BAND_TOP - 12, class_="flag-number") if has_room else None,
        id=f"moment-{number}",
        class_="moment",
        data_t=f"{moment.t_s:.4f}",
    )


def _figure(caption: str, legend: Sequence[tuple[str, str]], svg: Markup) -> Markup:
    entries = [tag("span", text, class_=f"key {colour}") for text, colour in legend]
    head = tag("figcaption", tag("b", caption), *entries, tag("output", "", class_="now"))
    return tag("figure", head, tag("div", svg, class_="scroll"))


def _grid(time: Axis, values: Axis) -> list[Markup]:
    pieces = []
    for tick in values.ticks(4):
        y = values.at(tick)
        pieces.append(tag("path", d=f"M{LEFT} {plain(y)}H{RIGHT}", class_="grid"))
        text = label(tick)
        pieces.append(tag("text", text, x=label_end(text, LEFT), y=y + 4, class_="value"))
    return [*pieces, *_time_labels(time, Axis(0.0, 1.0, BOTTOM, TOP), HEIGHT)]


def _time_labels(time: Axis, height: Axis, bottom: float) -> list[Markup]:
    pieces = []
    for tick in time.ticks(12):
        x = time.at(tick)
        grid = f"M{plain(x)} {plain(height.begin)}V{plain(height.end)}"
        pieces.append(tag("path", d=grid, class_="grid"))
        anchor = "tick last" if x > RIGHT - 12 else "tick"
        pieces.append(tag("text", f"{label(tick)} s", x=x, y=bottom - 4, class_=anchor))
    return pieces


def _cursor(top: float, bottom: float) -> Markup:
    return tag("path", d=f"M0 {top}V{bottom}", class_="cursor")
