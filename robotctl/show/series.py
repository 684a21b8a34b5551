"""Values over time and positions of a robot, thinned out while reading; number fields of topics."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from math import hypot, isfinite
from statistics import median
from typing import Final, NamedTuple

from robotctl.base.errors import IN_PARENTHESES, UnreadableFile, UsageError
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.definition import (
    Definition,
    FieldShape,
    UnreadableType,
    parse_definition,
)
from robotctl.messages.fields import LeafField, Steps, leaf_fields, parse_path, value_at
from robotctl.messages.values import WrongValue, decode
from robotctl.recording import Recording, TopicInfo
from robotctl.show.figure import Figure, Line, time_figure

COLUMNS: Final = 600
"""Columns of a plot; the eye cannot distinguish several values in one column."""

GAP: Final = 10.0
"""A pause longer than this many times the median gap between columns breaks the line."""

MAX_VALUE: Final = 1e15
"""Larger values are no measurement; they are left out and counted in `Series.odd`."""

Sample = tuple[float, float]
"""A time [s] and a value."""


class SeriesColumn(NamedTuple):
    """The values in one column: the first and last with their times, the least and the largest."""

    begin_s: float
    first: float
    least: float
    most: float
    end_s: float
    last: float


class Series:
    """Values at times from 0 to `duration_s`; memory use does not depend on how many there are.

    `count` is the number of values, and `odd` how many were not finite or too large.
    """

    def __init__(self, duration_s: float) -> None:
        self.count = 0
        self.odd = 0
        self._per_s = COLUMNS / duration_s if duration_s > 0.0 else 0.0
        self._columns: dict[int, SeriesColumn] = {}

    def add(self, t_s: float, value: float) -> None:
        """Add a value; values in one column must be added in the order of time."""
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
        """The columns with values, in the order of time."""
        return [self._columns[place] for place in sorted(self._columns)]

    @property
    def least(self) -> float | None:
        """The smallest value, None if there is none."""
        return min((column.least for column in self._columns.values()), default=None)

    @property
    def most(self) -> float | None:
        """The largest value, None if there is none."""
        return max((column.most for column in self._columns.values()), default=None)

    def lines(self) -> Iterator[list[Sample]]:
        """Yield the points of each unbroken line."""
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
    """Return at most four points, which in a plot look like all values of the column."""
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
    """A position [m] and when the robot was there [s]."""

    t_s: float
    x: float
    y: float


class ThinnedPath:
    """The places of a robot in the order of time; a place too close to the last one is skipped."""

    def __init__(self) -> None:
        self.places: list[DrivenPlace] = []
        self._spacing_m = SPACING_M
        self._last: DrivenPlace | None = None

    def add(self, t_s: float, x: float, y: float) -> None:
        """Add a position, unless it is impossible or too close to the last place."""
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
        """Return the places, including the last position of the robot."""
        ends = self._last is not None and self._last != self.places[-1]
        return [*self.places, self._last] if ends and self._last is not None else self.places


MAX_SEARCHED: Final = 5000
"""Limit on the leaf fields of a type that are searched."""
MAX_LISTS: Final = 24
"""Limit on the sequences of messages that are searched: each search looks at all types."""
MAX_NAMED: Final = 24
"""Limit on the fields that an error names."""
MAX_FIELDS: Final = 8
"""Limit on the fields that a picture shows."""


@dataclass(frozen=True, slots=True)
class FieldSeries:
    """A field and its values over time.

    `absent` counts the messages whose list is too short for the index in the path.
    """

    path: str
    series: Series
    absent: int

    def figure(self, duration_s: float) -> Figure:
        """Return a figure of the field over time; it has no line if there are no values."""
        return time_figure(self.path, [Line(list(self.series.lines()), "command")], duration_s)


@dataclass(slots=True)
class _Wanted:
    path: str
    steps: Steps
    series: Series
    absent: int = 0


def number_fields(topic: TopicInfo, paths: Sequence[str]) -> list[tuple[str, Steps]]:
    """Return path and steps of each number at `paths`; a message's path gives all its numbers.

    Raises:
        UsageError: A path leads to no number, no path is given, or there are too many numbers.
        UnreadableFile: The recording does not describe the type.
    """
    definition = _definition(topic)
    if not paths:
        raise UsageError(f"no field of {topic.name} is given", _named(definition))
    found: dict[str, Steps] = {}
    for path in paths:
        found |= _numbers_at(definition, path)
    if len(found) > MAX_FIELDS:
        raise UsageError(f"{len(found)} fields are too many for a picture", f"give {MAX_FIELDS}")
    return list(found.items())


def read_fields(
    recording: Recording,
    topic: TopicInfo,
    fields: Sequence[tuple[str, Steps]],
    on_missing: Callable[[str], None],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[FieldSeries]:
    """Read these fields of all messages of a topic; times count from the recording's first message.

    `on_missing` gets a sentence about each part that cannot be read.
    """
    info = recording.info()
    definition = _definition(topic)
    wanted = [_Wanted(path, steps, Series(info.duration_s)) for path, steps in fields]
    undecoded = 0
    for message in recording.in_order_written({topic.name}, on_missing, on_progress):
        if message.type_name != topic.type_name:
            continue
        try:
            values = decode(definition, message.data)
        except (struct.error, RecursionError, MemoryError):
            undecoded += 1
            continue
        t_s = (message.log_ns - info.start_ns) / NS_PER_S
        for each in wanted:
            try:
                each.series.add(t_s, float(value_at(values, each.steps)))
            except WrongValue:
                each.absent += 1
    if undecoded:
        on_missing(f"{undecoded} messages of {topic.name} cannot be decoded")
    return [FieldSeries(each.path, each.series, each.absent) for each in wanted]


def _definition(topic: TopicInfo) -> Definition:
    if not topic.definition.strip():
        raise UnreadableFile(f"the recording does not describe the type {topic.type_name}")
    try:
        return parse_definition(topic.type_name, topic.definition)
    except UnreadableType as error:
        raise UnreadableFile(f"the type {topic.type_name} cannot be read: {error}") from None


def _numbers_at(definition: Definition, path: str) -> dict[str, Steps]:
    try:
        steps = parse_path(definition, path)
    except WrongValue as error:
        text = str(error)
        cure = "" if "did you mean" in text else _named(definition)
        raise UsageError(text, cure, sentence=IN_PARENTHESES) from None
    leaves = list(islice(leaf_fields(definition, *_listed(definition, steps)), MAX_SEARCHED))
    leaf = next((each for each in leaves if each.steps == steps), None)
    if leaf is None and isinstance(steps[-1], int):
        owner = next((each for each in leaves if each.steps == steps[:-1]), None)
        if owner is not None and owner.is_number_list:
            return {path: steps}
    if leaf is not None and leaf.is_number:
        return {path: steps}
    if leaf is not None and (names := _names(_with_lists(definition, [leaf]))):
        cause = f"{path} is a list: {leaf.field.type_text}"
        raise UsageError(cause, f"choose one value: {names[0]}")
    below = {
        each.path: each.steps
        for each in leaves
        if each.is_number and each.steps[: len(steps)] == steps
    }
    if below:
        return below
    raise UsageError(f"{path} is no number", _named(definition))


def _listed(definition: Definition, steps: Steps) -> tuple[str, Steps]:
    """Return type and steps of the last message along `steps` that is an item of a sequence.

    Without such a message, return the topic's type and no steps.
    """
    found: tuple[str, Steps] = definition.root, ()
    fields = definition.types[definition.root]
    field = fields[0]
    for place, step in enumerate(steps, 1):
        if isinstance(step, str):
            field = next(each for each in fields if each.name == step)
            fields = definition.types.get(field.type_name, ())
        elif fields and field.shape is FieldShape.SEQUENCE:
            found = field.type_name, steps[:place]
    return found


def _with_lists(definition: Definition, leaves: Iterable[LeafField]) -> Iterable[LeafField]:
    """Return the leaves; each sequence of messages is followed by the leaves of its first item.

    This is done for the first MAX_LISTS sequences. At most MAX_SEARCHED leaves are returned.
    """
    room = iter(range(MAX_LISTS))

    def walk(leaves: Iterable[LeafField]) -> Iterator[LeafField]:
        for leaf in leaves:
            yield leaf
            if leaf.field.type_name in definition.types and next(room, None) is not None:
                yield from walk(leaf_fields(definition, leaf.field.type_name, (*leaf.steps, 0)))

    return islice(walk(leaves), MAX_SEARCHED)


def _names(leaves: Iterable[LeafField]) -> list[str]:
    """Return the path of each number among the leaves; of a list of numbers, that of its first."""
    return [
        f"{leaf.path}[0]" if leaf.is_number_list else leaf.path
        for leaf in leaves
        if leaf.is_number or leaf.is_number_list
    ]


def _named(definition: Definition) -> str:
    """Return a sentence that lists the numbers of a type."""
    names = _names(_with_lists(definition, leaf_fields(definition)))
    if not names:
        return "it has no numbers"
    more = len(names) - MAX_NAMED
    rest = f" and {more} more" if more > 0 else ""
    return f"its numbers are {', '.join(names[:MAX_NAMED])}{rest}"
