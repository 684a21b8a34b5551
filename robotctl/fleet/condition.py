"""A condition over rows, such as `laps >= 1 and max_error_m > 0.1`, as SQL with parameters.

The language is Python's for comparisons: names of columns, numbers, texts, True, False and None,
`+ - * /`, `< <= == != >= >`, `and or not` and parentheses. Nothing of it is run by Python.
"""

from __future__ import annotations

import ast
from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final

from robotctl.errors import UsageError
from robotctl.fleet.database import name

MAX_CHARACTERS: Final = 2000

_COMPARISONS: Final[dict[type[ast.cmpop], str]] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Eq: "=",
    ast.NotEq: "<>",
    ast.GtE: ">=",
    ast.Gt: ">",
}
_ARITHMETIC: Final[dict[type[ast.operator], str]] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
}
_CURE: Final = "write it like: laps >= 1 and max_error_m > 0.1"


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition in SQL, and the values of its parameters in their order."""

    sql: str
    values: tuple[Any, ...]


def parse_condition(source: str, columns: Collection[str]) -> Condition:
    """Return the condition in SQL.

    Raises:
        UsageError: It is not a condition, or names an unknown column.
    """
    if len(source) > MAX_CHARACTERS:
        raise UsageError(f"the condition has more than {MAX_CHARACTERS} characters")
    try:
        tree = ast.parse(source.strip(), mode="eval").body
        parser = _Parser(columns)
        sql = parser.sql(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        hint = "compare with ==, not =" if "=" in source and "==" not in source else _CURE
        raise UsageError(f"{_shown(source)} is not a condition", hint) from None
    return Condition(sql, tuple(parser.values))


def known_column(wanted: str, columns: Collection[str]) -> str:
    """Return the name of a column.

    Raises:
        UsageError: There is none of that name.
    """
    if wanted in columns:
        return wanted
    near = get_close_matches(wanted, columns, n=1)
    cure = f"did you mean {near[0]}?" if near else f"there are: {', '.join(columns)}"
    raise UsageError(f"there is no column {_shown(wanted)}", cure)


class _Parser:
    """Turns the tree of a condition into SQL; raises ValueError for what is not of the language."""

    def __init__(self, columns: Collection[str]) -> None:
        self._columns = columns
        self.values: list[Any] = []

    def sql(self, node: ast.expr) -> str:
        match node:
            case ast.BoolOp():
                word = " AND " if isinstance(node.op, ast.And) else " OR "
                return f"({word.join(map(self.sql, node.values))})"
            case ast.UnaryOp(op=ast.Not()):
                return f"(NOT {self.sql(node.operand)})"
            case ast.UnaryOp(op=ast.USub()):
                return f"(- {self.sql(node.operand)})"
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                sign = _ARITHMETIC[type(node.op)]
                return f"({self.sql(node.left)} {sign} {self.sql(node.right)})"
            case ast.Compare():
                return self._comparison(node)
            case ast.Name():
                return name(known_column(node.id, self._columns))
            case ast.Constant(value=str() | int() | float() as value):
                self.values.append(value)
                return "?"
        raise ValueError

    def _comparison(self, node: ast.Compare) -> str:
        parts = []
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            parts.append(self._one(left, operator, right))
            left = right
        return f"({' AND '.join(parts)})"

    def _one(self, left: ast.expr, operator: ast.cmpop, right: ast.expr) -> str:
        if isinstance(right, ast.Constant) and right.value is None:
            if isinstance(operator, ast.Eq | ast.Is):
                return f"{self.sql(left)} IS NULL"
            if isinstance(operator, ast.NotEq | ast.IsNot):
                return f"{self.sql(left)} IS NOT NULL"
        if type(operator) not in _COMPARISONS:
            raise ValueError
        return f"{self.sql(left)} {_COMPARISONS[type(operator)]} {self.sql(right)}"


def _shown(source: str) -> str:
    return repr(source if len(source) <= 60 else source[:57] + "...")
