"""The JSON form of the kernel's values; nan and inf are strings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import lru_cache
from math import isfinite
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State

T = TypeVar("T")


def to_json(value: Any) -> str:
    """Return the JSON text of a kernel dataclass, or of the value of one of its fields."""
    return _WRITERS[type(value)](value)


def from_json(kind: Callable[..., T], text: str) -> T:
    """Return the value of type `kind` in a text of `to_json`.

    A missing field takes its default; an unknown field is ignored.

    Raises:
        ValueError: `text` is not a value of type `kind`.
    """
    try:
        value: T = _reader(kind)(json.loads(text))
    except (KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"not a {getattr(kind, '__name__', kind)}: {text[:80]}") from error
    return value


class _Writers(dict[Any, Callable[[Any], str]]):
    """The function that writes each type, made on first use."""

    def __missing__(self, kind: Any) -> Callable[[Any], str]:
        self[kind] = _writer(kind)
        return self[kind]


_WRITERS = _Writers()


def _writer(kind: Any) -> Callable[[Any], str]:
    """Return a function that writes a value of type `kind`."""
    if kind is float:
        return lambda value: repr(value) if isfinite(value) else f'"{value!r}"'
    if kind is bool:
        return lambda value: "true" if value else "false"
    if kind is int:
        return repr
    if kind is str:
        return json.dumps
    if kind is NoneType:
        return lambda value: "null"
    if kind is tuple:
        return lambda value: f"[{','.join(map(to_json, value))}]"
    if issubclass(kind, Enum):
        return {member: json.dumps(member.value) for member in kind}.__getitem__
    return _fields_writer(kind)


def _fields_writer(kind: Any) -> Callable[[Any], str]:
    names = [field.name for field in fields(kind)]
    template = "{" + ",".join(f'"{name}":%s' for name in names) + "}"
    if len(names) < 2:
        return lambda value: template % tuple([to_json(getattr(value, name)) for name in names])
    values_of, writers = attrgetter(*names), _WRITERS

    def write(value: Any) -> str:
        return template % tuple([writers[type(each)](each) for each in values_of(value)])

    return write


@lru_cache(maxsize=256)
def _reader(kind: Any) -> Callable[[Any], Any]:
    """Return a function that converts a result of `json.loads` to the type `kind`."""
    if kind is float:
        return float
    if kind in (int, str, bool):
        return _exactly(kind)
    origin = get_origin(kind)
    if origin is tuple:
        return _tuple_reader(get_args(kind))
    if origin in (Union, UnionType):
        (some,) = (_reader(option) for option in get_args(kind) if option is not NoneType)
        return lambda plain: None if plain is None else some(plain)
    if isinstance(kind, type) and is_dataclass(kind):
        return _fields_reader(kind)
    return lambda plain: kind(plain)


def _fields_reader(kind: Any) -> Callable[[Any], Any]:
    readers = {name: _reader(hint) for name, hint in get_type_hints(kind).items()}
    optional = {
        field.name
        for field in fields(kind)
        if field.default is not MISSING or field.default_factory is not MISSING
    }

    def read(plain: Any) -> Any:
        if not isinstance(plain, dict):
            raise TypeError(f"{plain!r} is not a {kind.__name__}")
        return kind(
            **{
                name: read_field(plain[name])
                for name, read_field in readers.items()
                if name in plain or name not in optional
            }
        )

    return read


def _exactly(kind: type) -> Callable[[Any], Any]:
    def read(plain: Any) -> Any:
        if type(plain) is not kind:
            raise TypeError(f"{plain!r} is not a {kind.__name__}")
        return plain

    return read


def _tuple_reader(items: tuple[Any, ...]) -> Callable[[Any], tuple[Any, ...]]:
    if items[-1] is Ellipsis:
        read = _reader(items[0])
        return lambda plain: tuple(read(item) for item in plain)
    readers = [_reader(item) for item in items]
    return lambda plain: tuple(read(item) for read, item in zip(readers, plain, strict=True))


def finite_or_none(value: float) -> float | None:
    """Return `value`, None if it is NaN or infinite."""
    return value if isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Proof:
    """Totals up to a snapshot: the number of velocity commands, and the CRC-32 of the journal."""

    commands: int
    journal_crc: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a kernel between two events.

    `made_by` names the Python that computed it. `proof` is None in recordings of version 0.1.0.
    """

    made_by: str
    params: KernelParams
    state: State
    proof: Proof | None = None

    def kernel(self) -> Kernel:
        """Return a new kernel that continues from this snapshot."""
        return Kernel(self.params, self.state)
