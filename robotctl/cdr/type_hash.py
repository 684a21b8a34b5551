"""The RIHS01 hash of a ROS type, computed from its fields (REP 2016)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from hashlib import sha256
from typing import Any, Final

from robotctl.cdr.definition import Definition, Field, FieldShape, is_built_in

_NESTED: Final = 1
_BUILT_IN: Final[Mapping[str, int]] = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,  # a .msg file calls an uint8 so
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
_BOUNDED_TEXT: Final = 4
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
"""What is added to the number of a type, as in type_description_interfaces/msg/FieldType."""

_EMPTY: Final = (Field("structure_needs_at_least_one_member", "uint8"),)
"""The fields of a type without fields."""


def rihs01_hash(type_name: str, definition: Definition) -> str:
    """Return the hash of a type `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T` with its fields.

    Comments, constants and default values do not change it.
    """
    package, _, rest = type_name.partition("/")
    own_kind = rest.partition("/")[0]

    def full(short: str) -> str:
        owner, _, name = short.partition("/")
        implied = owner == package and "_" in name  # by a service or action: T_Request
        return f"{owner}/{own_kind if implied else 'msg'}/{name}"

    def described(short: str, name: str) -> dict[str, Any]:
        fields = definition.types[short] or _EMPTY
        return {"type_name": name, "fields": [_described(field, full) for field in fields]}

    others = sorted((full(short), short) for short in _needed(definition))
    text = json.dumps(
        {
            "type_description": described(definition.root, type_name),
            "referenced_type_descriptions": [described(short, name) for name, short in others],
        }
    )
    return f"RIHS01_{sha256(text.encode()).hexdigest()}"


def _described(field: Field, full: Callable[[str], str]) -> dict[str, Any]:
    built_in = is_built_in(field.type_name)
    number = _BUILT_IN[field.type_name] if built_in else _NESTED
    if field.text_bound is not None:
        number += _BOUNDED_TEXT
    match field.shape:
        case FieldShape.ARRAY:
            number += _ARRAY
        case FieldShape.SEQUENCE:
            number += _SEQUENCE if field.length is None else _BOUNDED_SEQUENCE
        case FieldShape.ONE:
            pass
    return {
        "name": field.name,
        "type": {
            "type_id": number,
            "capacity": field.length or 0,
            "string_capacity": field.text_bound or 0,
            "nested_type_name": "" if built_in else full(field.type_name),
        },
    }


def _needed(definition: Definition) -> set[str]:
    """Return the types that the root needs, as `pkg/T`."""
    needed: set[str] = set()
    waiting = [definition.root]
    while waiting:
        for field in definition.types[waiting.pop()]:
            if not is_built_in(field.type_name) and field.type_name not in needed:
                needed.add(field.type_name)
                waiting.append(field.type_name)
    return needed
