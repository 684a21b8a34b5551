"""The page of two recordings beside each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from robotctl.report.axis import Axis
from robotctl.report.cursor_data import cursor_data
from robotctl.report.figures import Figure, figures_of
from robotctl.report.judged import ReportFindings
from robotctl.report.markup import Content, Markup, joined, tag
from robotctl.report.page import document, footer, section
from robotctl.report.path_plot import Track, ground_of, path_plot
from robotctl.report.recorded import Recorded
from robotctl.report.series import Series
from robotctl.report.tables import parameter_values, table
from robotctl.report.time_plot import (
    LEAST_ERROR_M,
    LEAST_SPEED,
    Plot,
    PlotLine,
    time_axis,
    time_plot,
)
from robotctl.report.traces import Point, Traces

MOVING: Final = "MOVING"
NAMES: Final = ("A", "B")
COLOURS: Final = ("a", "b")

Side = tuple[Recorded, ReportFindings]


def comparison_page(first: Side, second: Side) -> str:
    """Return the page that compares the second recording with the first."""
    sides = (first, second)
    recordings = [recorded for recorded, _ in sides]
    traces = [recorded.traces for recorded in recordings]
    axis = time_axis(max(each.duration_s - _motion_begin_s(each) for each in traces))
    plots = _plots(traces)
    names = [each.info.path.resolve().name for each in recordings]
    body = joined(
        _header(names, [judged for _, judged in sides]),
        section("figures", "Figures", _figures(*map(figures_of, recordings))),
        *_sections(recordings, plots, axis),
        section("parameters", "Different parameters", _parameters(recordings)),
        footer(),
    )
    return document(f"{names[0]} and {names[1]}: robotctl report", body, cursor_data(axis, plots))


def _header(names: Sequence[str], judged: Sequence[ReportFindings]) -> Markup:
    lines = []
    for name, colour, of_name, found in zip(NAMES, COLOURS, names, judged, strict=True):
        badges = [
            tag("span", f"{each.command}: {each.verdict}", class_=f"badge {each.tone.value}")
            for each in found.judgements
        ]
        title = tag("h1", tag("span", f"{name} ", class_=f"key {colour}"), of_name)
        lines.append(joined(title, tag("p", *badges, class_="badges")))
    return tag("header", tag("p", "robotctl report --compare", class_="product"), *lines)


def _figures(first: Sequence[Figure], second: Sequence[Figure]) -> Markup:
    rows = []
    for one, other in zip(first, second, strict=True):
        more = ""
        if one.value is not None and other.value is not None:
            more = f"{other.value - one.value:+{one.form}} {one.unit}".rstrip()
        rows.append((one.name, one.text, other.text, more))
    return table(("Figure", *NAMES, "B - A"), rows)


def _sections(
    recordings: Sequence[Recorded], plots: Sequence[Plot], axis: Axis
) -> Iterator[Content]:
    paths = [_from_begin(recorded.traces) for recorded in recordings]
    points = [point for path in paths for point in path]
    if points:
        tracks = [Track(path, colour) for path, colour in zip(paths, COLOURS, strict=True)]
        wanted = [
            Track([_moved(point, recorded.traces) for point in outline], "wanted")
            for recorded in recordings
            for outline in recorded.traces.wanted
        ]
        ground = ground_of([*points, *(point for each in wanted for point in each.points)])
        note = tag("p", "Each path begins at 0, 0. By odometry.", class_="note")
        picture = tag("figure", _legend(), path_plot([*wanted, *tracks], ground, ()))
        yield section("path", "Paths", picture, note)
    note = tag("p", "Time 0 is where each robot begins to move.", class_="note")
    drawn = [time_plot(plot, axis, number) for number, plot in enumerate(plots, 1)]
    yield section("time", "Over time", note, *drawn)


def _plots(traces: Sequence[Traces]) -> list[Plot]:
    def lines(*series: Series) -> tuple[PlotLine, ...]:
        return tuple(
            PlotLine(each, name, colour, _motion_begin_s(of))
            for each, name, colour, of in zip(series, NAMES, COLOURS, traces, strict=True)
        )

    return [
        Plot("Off track", "m", lines(*(each.error for each in traces)), LEAST_ERROR_M, True),
        Plot("Speed", "m/s", lines(*(each.linear for each in traces)), LEAST_SPEED),
        Plot("Turn rate", "rad/s", lines(*(each.angular for each in traces)), LEAST_SPEED),
    ]


def _legend() -> Markup:
    entries = [
        tag("span", name, class_=f"key {colour}")
        for name, colour in zip(NAMES, COLOURS, strict=True)
    ]
    return tag("figcaption", *entries, tag("span", "wanted", class_="key wanted"))


def _motion_begin_s(traces: Traces) -> float:
    return next((span.begin_s for span in traces.modes if span.mode == MOVING), 0.0)


def _from_begin(traces: Traces) -> list[Point]:
    return [_moved((place.x, place.y), traces) for place in traces.driven.whole()]


def _moved(point: Point, traces: Traces) -> Point:
    """Return a point relative to where the robot was first."""
    begin = traces.driven.places[0]
    return point[0] - begin.x, point[1] - begin.y


def _parameters(recordings: Sequence[Recorded]) -> Markup:
    first, second = (parameter_values(recorded) for recorded in recordings)
    rows = [
        (key, first.get(key, "not known"), second.get(key, "not known"))
        for key in sorted(first.keys() | second.keys())
        if first.get(key) != second.get(key)
    ]
    return table(("Parameter", *NAMES), rows) if rows else tag("p", "None.", class_="note")
