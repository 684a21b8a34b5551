"""A stand-in for `launch` and `launch_ros`, which no package index has: made from `names.toml`.

Each class takes the arguments of the real one, and no others.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

NAMES = Path(__file__).with_name("names.toml")


class Made:
    """An object of a class of the table, with the arguments that it was made with."""

    table: Mapping[str, list[str]]

    def __init__(self, *given: Any, **named: Any) -> None:
        """Take the arguments that the table allows.

        Raises:
            TypeError: The real class would not take them.
        """
        positional = self.table.get("positional", [])
        if len(given) > len(positional):
            raise TypeError(f"{type(self).__name__} takes {positional} without a name")
        self.given = {**dict(zip(positional, given, strict=False)), **named}
        allowed = {*positional, *self.table.get("keywords", [])}
        if unknown := set(self.given) - allowed:
            raise TypeError(f"{type(self).__name__} does not take {sorted(unknown)}")
        if missing := set(self.table.get("required", [])) - set(self.given):
            raise TypeError(f"{type(self).__name__} needs {sorted(missing)}")

    def perform(self, context: Mapping[str, str]) -> str:
        """Return the value of a LaunchConfiguration; the context is the arguments of a launch."""
        return context[self.given["variable_name"]]


def classes() -> dict[str, Mapping[str, list[str]]]:
    """Return full name -> table of each class."""
    found: dict[str, Mapping[str, list[str]]] = {}

    def walk(name: str, content: Mapping[str, Any]) -> None:
        if "positional" in content or "keywords" in content:
            found[name] = content
            return
        for key, inner in content.items():
            walk(f"{name}.{key}" if name else key, inner)

    walk("", tomllib.loads(NAMES.read_text()))
    return found


@contextmanager
def stand_in() -> Iterator[None]:
    """Let `launch` and `launch_ros` be imported within the block."""
    modules: dict[str, ModuleType] = {}
    for full, table in classes().items():
        place, _, name = full.rpartition(".")
        root = place.partition(".")[0]
        for each in (root, place):
            modules.setdefault(each, ModuleType(each))
        setattr(modules[place], name, type(name, (Made,), {"table": table}))
    with patch.dict(sys.modules, modules):
        yield
