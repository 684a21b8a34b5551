"""Values over time and positions of a robot, thinned out while reading; number fields of topics."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, isfinite
from statistics import median
from typing import Final, NamedTuple

from robotctl.base.errors import IN_PARENTHESES, UsageError
from robotctl.kernel.constants import NS_PER_S
from robotctl.messages.definition import NUMBERS, Definition, FieldShape
from robotctl.messages.fields import FieldPath, ValueKind, WrongValue, leaves, parse_path, value_at
from robotctl.messages.values import Decoder
from robotctl.recording import Recording, TopicInfo
from robotctl.recording.table import recorded_definition
from robotctl.show.figure import Figure, Line, time_figure

COLUMNS: Final = 600
"""Columns of a plot."""

GAP: Final = 10.0
"""Length of a pause that breaks the line, in median gaps between columns."""

MAX_VALUE: Final = 1e15
"""Larger values are left out of a series, as are those that are not finite."""

Sample = tuple[float, float]
"""A time [s] and a value."""


class SeriesColumn(NamedTuple):
    """The first, last, least and largest value in one time span of a plot, with its two ends."""

    begin_s: float
    first: float
    least: float
    most: float
    end_s: float
    last: float


class Series:
    """Values over time, reduced to COLUMNS time spans; `odd` counts the values left out."""

    def __init__(self, duration_s: float) -> None:
        self.count = 0
        self.odd = 0
        self._per_s = COLUMNS / duration_s if duration_s > 0.0 else 0.0
        self._columns: dict[int, SeriesColumn] = {}

    def add(self, t_s: float, value: float) -> None:
        """Add a value at the time `t_s` [s]. Values come in the order of time."""
        if not (isfinite(value) and abs(value) <= MAX_VALUE):
            self.odd += 1
            return
        self.count += 1
        place = min(max(int(t_s * self._per_s), 0), COLUMNS)
        known = self._columns.get(place)
        if known is None:
            self._columns[place] = SeriesColumn(t_s, value, value, value, t_s, value)
        else:
            least, most = min(known.least, value), max(known.most, value)
            self._columns[place] = SeriesColumn(known.begin_s, known.first, least, most, t_s, value)

    @property
    def columns(self) -> list[SeriesColumn]:
        """The time spans that contain values, in the order of time."""
        return [self._columns[place] for place in sorted(self._columns)]

    @property
    def least(self) -> float | None:
        """The smallest value, None if there is none."""
        return min((column.least for column in self._columns.values()), default=None)

    @property
    def most(self) -> float | None:
        """The largest value, None for a series without values."""
        return max((column.most for column in self._columns.values()), default=None)

    def lines(self) -> Iterator[list[Sample]]:
        """Yield the points of each line. A long pause between values begins a new line."""
        columns = self.columns
        if not columns:
            return
        gaps_s = [after.begin_s - before.end_s for before, after in pairwise(columns)]
        limit_s = max(GAP * median(gaps_s), 4.0 / self._per_s) if gaps_s and self._per_s else 0.0
        line: list[Sample] = []
        for column, gap_s in zip(columns, [*gaps_s, 0.0], strict=True):
            line += _points(column)
            if gap_s > limit_s:
                yield line
                line = []
        yield line


def _points(column: SeriesColumn) -> Sequence[Sample]:
    """Return at most four points, which look like all values of the column."""
    if column.begin_s == column.end_s:
        return [(column.begin_s, column.first)]
    middle_s = (column.begin_s + column.end_s) / 2.0
    between = [
        (middle_s, value)
        for value in (column.least, column.most)
        if value not in (column.first, column.last)
    ]
    return [(column.begin_s, column.first), *between, (column.end_s, column.last)]


MAX_PLACES: Final = 3000
"""If a path gets more places, every second one is removed, and the spacing doubles."""

SPACING_M: Final = 0.002
MAX_COORDINATE_M: Final = 1e6


def is_on_earth(x: float, y: float) -> bool:
    """Return whether a position is finite and within MAX_COORDINATE_M."""
    return isfinite(x) and isfinite(y) and max(abs(x), abs(y)) <= MAX_COORDINATE_M


class DrivenPlace(NamedTuple):
    """A position [m] and the time at which the robot was there [s]."""

    t_s: float
    x: float
    y: float


class ThinnedPath:
    """The path of a robot, thinned out to at most MAX_PLACES positions."""

    def __init__(self) -> None:
        self.places: list[DrivenPlace] = []
        self._spacing_m = SPACING_M
        self._last: DrivenPlace | None = None

    def add(self, t_s: float, x: float, y: float) -> None:
        """Add a position [m]. Ignore it if it is not plausible or close to the last one kept."""
        if not is_on_earth(x, y):
            return
        self._last = DrivenPlace(t_s, x, y)
        if self.places:
            before = self.places[-1]
            if hypot(x - before.x, y - before.y) < self._spacing_m:
                return
        self.places.append(self._last)
        if len(self.places) > MAX_PLACES:
            del self.places[1::2]
            self._spacing_m *= 2.0

    def whole(self) -> list[DrivenPlace]:
        """Return the kept positions of the path, always including the robot's last one."""
        ends = self._last is not None and self._last != self.places[-1]
        return [*self.places, self._last] if ends and self._last is not None else self.places


MAX_LISTS: Final = 24
"""Limit on the sequences of messages that are searched."""
MAX_NAMED: Final = 24
"""Limit on the fields that an error names."""
MAX_FIELDS: Final = 8
"""Limit on the fields that a picture shows."""


@dataclass(slots=True)
class FieldSeries:
    """The values of a field over time; `absent` counts the messages that lack the field."""

    path: str
    series: Series
    absent: int = 0

    def figure(self, duration_s: float) -> Figure:
        """Return a figure of the field over time. It has no line if there are no values."""
        return time_figure(self.path, [Line(list(self.series.lines()), "command")], duration_s)


def number_fields(topic: TopicInfo, paths: Sequence[str]) -> list[FieldPath]:
    """Return the numeric fields at `paths`. A path to a nested message means all its numbers.

    Raises:
        UsageError: A path leads to no number, no path is given, or there are too many numbers.
        UnreadableFile: The recording has no definition of the topic's type.
    """
    definition = recorded_definition(topic)
    if not paths:
        raise UsageError(f"no field of {topic.name} is given", _named(definition))
    found = {each.name: each for path in paths for each in _numbers_at(definition, path)}
    if len(found) > MAX_FIELDS:
        raise UsageError(f"{len(found)} fields are too many for a picture", f"give {MAX_FIELDS}")
    return list(found.values())


def read_fields(
    recording: Recording,
    topic: TopicInfo,
    fields: Sequence[FieldPath],
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[FieldSeries]:
    """Return the values of fields in all messages of a topic, from time 0 at the recording's start.

    `on_missing` gets a sentence about each part that cannot be read.
    """
    info = recording.info()
    decoder = Decoder(recorded_definition(topic))
    found = [FieldSeries(each.name, Series(info.duration_s)) for each in fields]
    undecoded = 0
    for message in recording.in_order_written({topic.name}, on_missing, on_progress):
        if message.type_name != topic.type_name:
            continue
        try:
            values = decoder.values(message.data)
        except struct.error:
            undecoded += 1
            continue
        t_s = (message.log_ns - info.start_ns) / NS_PER_S
        for field, each in zip(fields, found, strict=True):
            try:
                each.series.add(t_s, float(value_at(values, field.steps)))
            except WrongValue:
                each.absent += 1
    if undecoded:
        on_missing(f"{undecoded} messages of {topic.name} cannot be decoded")
    return found


def _numbers_at(definition: Definition, path: str) -> list[FieldPath]:
    try:
        found = parse_path(definition, path)
    except WrongValue as error:
        text = str(error)
        cure = "" if "did you mean" in text else _named(definition)
        raise UsageError(text, cure, sentence=IN_PARENTHESES) from None
    if found.kind is ValueKind.NUMBER:
        return [found]
    below = list(leaves(definition, found))
    if numbers := [each for each in below if _is_plain_number(each)]:
        return numbers
    names = _names(_with_lists(definition, below))
    if names and found.field.shape is not FieldShape.ONE:
        cause = f"{path} is a list: {found.field.type_text}"
        raise UsageError(cause, f"choose one value: {names[0]}")
    raise UsageError(f"{path} is no number", _named(definition))


def _is_plain_number(path: FieldPath) -> bool:
    """Return whether a field is a number, and not one of an array."""
    return path.kind is ValueKind.NUMBER and not isinstance(path.steps[-1], int)


def _with_lists(
    definition: Definition, found: Iterable[FieldPath], room: Iterator[int] | None = None
) -> Iterator[FieldPath]:
    """Yield `found`, and after each sequence of messages the fields of its first item."""
    room = iter(range(MAX_LISTS)) if room is None else room
    for each in found:
        yield each
        if each.kind is ValueKind.NESTED and next(room, None) is not None:
            first = FieldPath((*each.steps, 0), each.field.item)
            yield from _with_lists(definition, leaves(definition, first), room)


def _names(found: Iterable[FieldPath]) -> list[str]:
    """Return the path of each number in `found`, for a list that of its first number."""
    names = []
    for each in found:
        if _is_plain_number(each) or (each.kind is ValueKind.NUMBER and each.steps[-1] == 0):
            names.append(each.name)
        elif each.field.shape is not FieldShape.ONE and each.field.type_name in NUMBERS:
            names.append(f"{each.name}[0]")
    return names


def _named(definition: Definition) -> str:
    """Return a sentence that lists the numbers of a type."""
    names = _names(_with_lists(definition, leaves(definition)))
    if not names:
        return "it has no numbers"
    more = len(names) - MAX_NAMED
    rest = f" and {more} more" if more > 0 else ""
    return f"its numbers are {', '.join(names[:MAX_NAMED])}{rest}"
