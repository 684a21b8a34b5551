"""Topics with type, count and rate, as wide as the terminal and at most 80 columns."""

from __future__ import annotations

from collections.abc import Iterable

from robotctl.cli.text import columns, elided, number, printable

_MIN_NAME_WIDTH, _COUNT_WIDTH, _RATE_WIDTH = 24, 8, 7
_INDENT_AND_GAPS = 5


class TopicTable:
    """Header and rows of the same widths; the types get the room that the names leave."""

    def __init__(self, names: Iterable[object]) -> None:
        longest = max((len(printable(name)) for name in names), default=0)
        both = columns() - _INDENT_AND_GAPS - _COUNT_WIDTH - _RATE_WIDTH
        most = both * 2 // 3
        self._name_width = min(max(longest, _MIN_NAME_WIDTH), most)
        self._type_width = both - self._name_width

    @property
    def header(self) -> str:
        """The line above the rows."""
        return self._line("topic", "type", "count", "Hz")

    def row(self, name: object, type_name: object, count: object, rate_hz: object) -> str:
        """One topic, its type without `/msg` so that it fits."""
        rate = number(rate_hz, ".1f")
        if len(rate) > _RATE_WIDTH:
            rate = number(rate_hz, ".1e")
        return self._line(name, str(type_name).replace("/msg/", "/"), count, rate)

    def _line(self, name: object, type_name: object, count: object, rate: str) -> str:
        return (
            f"  {elided(name, self._name_width):{self._name_width}} "
            f"{elided(type_name, self._type_width):{self._type_width}} "
            f"{count!s:>{_COUNT_WIDTH}} {rate:>{_RATE_WIDTH}}"
        )
