"""The driven path over the wanted one as SVG, to scale."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from robotctl.report.axis import Axis, label, label_end
from robotctl.report.driven import DrivenPlace
from robotctl.report.markup import Markup, plain, tag
from robotctl.report.traces import Point, TracedMoment

WIDTH: Final = 640
MARGIN_LEFT, MARGIN_TOP, MARGIN = 58, 14, 34
MIN_HEIGHT, MAX_HEIGHT = 200, 640
MIN_SPAN_M: Final = 0.1
ROOM: Final = 1.08
"""How much wider than the paths the picture is."""


@dataclass(frozen=True, slots=True)
class Track:
    """A line on the ground, with the class of its colour."""

    points: Sequence[Point]
    colour: str


@dataclass(frozen=True, slots=True)
class Ground:
    """The axes of the picture, of equal scale, and its height."""

    x: Axis
    y: Axis
    height: float


def ground_of(points: Iterable[Point]) -> Ground:
    """Return the axes for a picture of these points."""
    xs, ys = zip(*points, strict=True)
    wide = max(max(xs) - min(xs), MIN_SPAN_M) * ROOM
    high = max(max(ys) - min(ys), MIN_SPAN_M) * ROOM
    inner = WIDTH - MARGIN_LEFT - MARGIN
    scale = min(inner / wide, (MAX_HEIGHT - MARGIN_TOP - MARGIN) / high)
    height = min(max(high * scale + MARGIN_TOP + MARGIN, MIN_HEIGHT), MAX_HEIGHT)
    half_x = inner / scale / 2.0
    half_y = (height - MARGIN_TOP - MARGIN) / scale / 2.0
    middle_x, middle_y = (min(xs) + max(xs)) / 2.0, (min(ys) + max(ys)) / 2.0
    return Ground(
        Axis(middle_x - half_x, middle_x + half_x, MARGIN_LEFT, WIDTH - MARGIN),
        Axis(middle_y - half_y, middle_y + half_y, height - MARGIN, MARGIN_TOP),
        height,
    )


def path_plot(tracks: Sequence[Track], ground: Ground, marks: Sequence[Markup]) -> Markup:
    """Return the picture of the tracks, the later ones on top, with marks over them."""
    lines = [
        tag("path", d=_data(track.points, ground), class_=f"line {track.colour}")
        for track in tracks
        if track.points
    ]
    return tag(
        "svg",
        *_axes(ground),
        *lines,
        *marks,
        viewBox=f"0 0 {WIDTH} {plain(ground.height)}",
        class_="path",
        role="img",
        aria_label="the driven path over the wanted one",
        id="plot-path",
    )


def marks_on(
    places: Sequence[DrivenPlace], moments: Sequence[TracedMoment], ground: Ground
) -> list[Markup]:
    """Return marks for the begin, the end, each moment, and the place of the cursor."""
    if not places:
        return []
    first, last = places[0], places[-1]
    marks = [
        _numbered(number, moment, _place_at(places, moment.t_s), ground)
        for number, moment in enumerate(moments, 1)
    ]
    return [
        *marks,
        _circle(first, ground, "begin", "begin"),
        _circle(last, ground, "end", "end"),
        tag("circle", r=6, cx=0, cy=0, class_="cursor"),
    ]


def _place_at(places: Sequence[DrivenPlace], t_s: float) -> DrivenPlace:
    index = bisect_right(places, t_s, key=lambda place: place.t_s) - 1
    return places[max(index, 0)]


def _numbered(number: int, moment: TracedMoment, place: DrivenPlace, ground: Ground) -> Markup:
    x, y = ground.x.at(place.x), ground.y.at(place.y)
    return tag(
        "g",
        tag("title", f"{number}. {moment.t_s:.2f} s, {moment.kind}"),
        tag("circle", cx=x, cy=y, r=3.5, class_="flag"),
        class_="moment",
        data_t=f"{moment.t_s:.4f}",
    )


def _circle(place: DrivenPlace, ground: Ground, colour: str, name: str) -> Markup:
    x, y = ground.x.at(place.x), ground.y.at(place.y)
    return tag("g", tag("title", name), tag("circle", cx=x, cy=y, r=5, class_=f"place {colour}"))


def _data(points: Sequence[Point], ground: Ground) -> Markup:
    drawn = [f"{plain(ground.x.at(x))} {plain(ground.y.at(y))}" for x, y in points]
    return Markup(f"M{'L'.join(drawn if len(drawn) > 1 else drawn * 2)}")


def _axes(ground: Ground) -> list[Markup]:
    pieces = []
    bottom, left, right = ground.y.begin, ground.x.begin, ground.x.end
    for tick in ground.x.ticks(8):
        at = ground.x.at(tick)
        pieces.append(tag("path", d=f"M{plain(at)} {plain(bottom)}V{MARGIN_TOP}", class_="grid"))
        pieces.append(tag("text", label(tick), x=at, y=bottom + 16, class_="tick"))
    for tick in ground.y.ticks(8):
        at = ground.y.at(tick)
        pieces.append(tag("path", d=f"M{left} {plain(at)}H{right}", class_="grid"))
        text = label(tick)
        pieces.append(tag("text", text, x=label_end(text, left), y=at + 4, class_="value"))
    unit = tag("text", "x [m]", x=right, y=bottom + 30, class_="tick last")
    return [*pieces, unit, tag("text", "y [m]", x=left - 6, y=MARGIN_TOP - 2, class_="value")]
