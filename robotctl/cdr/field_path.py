"""A path to a field of a message, such as `pose.pose.position.x` or `ranges[0]`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from robotctl.cdr.definition import Definition, FieldShape
from robotctl.cdr.given import WrongValue, unknown_field

_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d{1,9}\])*)")
_INDEX = re.compile(r"\[(\d+)\]")

Steps = tuple[str | int, ...]


def parse_path(definition: Definition, path: str) -> Steps:
    """Return the names and indexes that lead to a field of the type.

    Raises:
        WrongValue: The path has another form, or leads to no field of the type.
    """
    steps: list[str | int] = []
    type_name = definition.root
    for text in path.split("."):
        match = _STEP.fullmatch(text)
        if match is None:
            raise WrongValue(f"{path!r} is no path to a field: use names with dots, like a.b[0].c")
        name, indexes = match[1], [int(each) for each in _INDEX.findall(match[2])]
        fields = definition.types.get(type_name)
        if fields is None:
            raise WrongValue(f"{path_text(steps)} is a {type_name}, which has no fields")
        field = next((each for each in fields if each.name == name), None)
        if field is None:
            raise WrongValue(unknown_field(name, type_name, fields))
        steps += [name, *indexes]
        if len(indexes) > (field.shape is not FieldShape.ONE):
            raise WrongValue(f"{path_text(steps[: -len(indexes)])} is a {field.type_text}: no list")
        if field.shape is FieldShape.ARRAY and indexes and indexes[0] >= (field.length or 0):
            raise WrongValue(f"{path_text(steps[:-1])} has {field.length} values, from [0]")
        is_list = field.shape is not FieldShape.ONE and not indexes
        type_name = field.type_text if is_list else field.type_name
    return tuple(steps)


def value_at(values: Mapping[str, Any], steps: Steps) -> Any:
    """Return the value at the end of a path.

    Raises:
        WrongValue: A sequence of this message is shorter than the path's index.
    """
    found: Any = values
    for place, step in enumerate(steps):
        try:
            found = found[step]
        except IndexError:
            count = len(found)
            raise WrongValue(
                f"{path_text(steps[:place])} has {count} values, no [{step}]"
            ) from None
    return found


def path_text(steps: Steps | list[str | int]) -> str:
    """Return the path that leads along the steps, such as `a.b[0].c`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)[1:]
