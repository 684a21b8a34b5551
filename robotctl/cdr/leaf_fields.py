"""The fields of a type that hold values, each with its path: `pose.pose.position.x`."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass

from robotctl.cdr.definition import NUMBERS, Definition, Field, FieldShape
from robotctl.cdr.field_path import Steps, path_text


@dataclass(frozen=True, slots=True)
class LeafField:
    """A field that is a number or a text, or a list of any length.

    `steps` lead to its value (see `cdr.field_path`). A list of numbers or texts is one leaf, and so
    is a sequence of messages: its length is known only of a message.
    """

    path: str
    steps: Steps
    field: Field

    @property
    def is_number(self) -> bool:
        """Whether the value is one number or truth value."""
        return self.field.shape is FieldShape.ONE and self.field.type_name in NUMBERS

    @property
    def is_number_list(self) -> bool:
        """Whether the value is a list of numbers or truth values."""
        return self.field.shape is not FieldShape.ONE and self.field.type_name in NUMBERS


def leaf_fields(definition: Definition, below: str = "", steps: Steps = ()) -> Iterator[LeafField]:
    """Yield the leaf fields of a type, or of its type `below`, in the order of their definition.

    `steps` lead to the message of the type `below`. A type of a recording may have any number of
    leaves: take no more than you can use.
    """
    return _leaves(definition, _types_with_leaves(definition), below or definition.root, steps)


def _leaves(
    definition: Definition, useful: Set[str], type_name: str, steps: Steps
) -> Iterator[LeafField]:
    for field in definition.types[type_name]:
        here = (*steps, field.name)
        if field.type_name not in definition.types or field.shape is FieldShape.SEQUENCE:
            yield LeafField(path_text(here), here, field)
        elif field.type_name not in useful:
            continue
        elif field.shape is FieldShape.ONE:
            yield from _leaves(definition, useful, field.type_name, here)
        else:
            for index in range(field.length or 0):
                yield from _leaves(definition, useful, field.type_name, (*here, index))


def _types_with_leaves(definition: Definition) -> Set[str]:
    """Return the types with at least one leaf: 2^64 messages without any are not searched."""
    useful: set[str] = set()
    before = -1
    while len(useful) > before:
        before = len(useful)
        for name, fields in definition.types.items():
            if any(
                field.type_name not in definition.types
                or field.shape is FieldShape.SEQUENCE
                or (field.type_name in useful and field.length != 0)
                for field in fields
            ):
                useful.add(name)
    return useful
