"""A table of topics with type, count and rate; without a terminal nothing is cut."""

from __future__ import annotations

from collections.abc import Iterable

from robotctl.cli.terminal.text import UNLIMITED, column_width, columns, elided, number

_MIN_NAME_WIDTH, _COUNT_WIDTH, _RATE_WIDTH = 24, 8, 7
_INDENT_AND_GAPS = 5


class TopicLines:
    """A table whose columns fit its topics; on a terminal, types get the rest."""

    def __init__(self, topics: Iterable[tuple[object, object]]) -> None:
        """Fit the columns to `topics`, the names and types of the rows."""
        shown = [(name, _short(type_name)) for name, type_name in topics]
        both = columns() - _INDENT_AND_GAPS - _COUNT_WIDTH - _RATE_WIDTH
        names, types = ([each[part] for each in shown] for part in (0, 1))
        self._name_width = column_width(names, at_least=_MIN_NAME_WIDTH, at_most=both * 2 // 3)
        self._type_width = both - self._name_width
        if columns() == UNLIMITED:
            self._type_width = column_width(types, at_least=len("type"), at_most=self._type_width)

    @property
    def header(self) -> str:
        """The header line."""
        return self._line("topic", "type", "count", "Hz")

    def row(self, name: object, type_name: object, count: object, rate_hz: object) -> str:
        """Return the line of one topic."""
        rate = number(rate_hz, ".1f")
        if len(rate) > _RATE_WIDTH:
            rate = number(rate_hz, ".1e")
        return self._line(name, _short(type_name), count, rate)

    def _line(self, name: object, type_name: object, count: object, rate: str) -> str:
        return (
            f"  {elided(name, self._name_width):{self._name_width}} "
            f"{elided(type_name, self._type_width):{self._type_width}} "
            f"{count!s:>{_COUNT_WIDTH}} {rate:>{_RATE_WIDTH}}"
        )


def _short(type_name: object) -> str:
    """Return the type without `/msg`."""
    return str(type_name).replace("/msg/", "/")
