"""The values of the kernel are immutable: a State is replaced as a whole."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, is_dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, cast, get_args

import pytest

from robotctl import kernel
from robotctl.kernel.drive import Drive
from robotctl.kernel.state import Health, State
from robotctl.kernel.types import Effect, Event, changed


def classes() -> list[type]:
    """Return every class of the kernel that is or should be a dataclass: it declares fields."""
    modules = [
        import_module(f"{kernel.__name__}.{each.name}") for each in iter_modules(kernel.__path__)
    ]
    return sorted(
        {
            value
            for module in modules
            for value in vars(module).values()
            if isinstance(value, type)
            and value.__module__.startswith(kernel.__name__)
            and not issubclass(value, tuple)
            and (is_dataclass(value) or "__annotations__" in vars(value))
        },
        key=lambda kind: kind.__qualname__,
    )


def values() -> list[type]:
    """Return every dataclass of the kernel."""
    return [each for each in classes() if is_dataclass(each)]


def test_whatever_declares_fields_and_every_event_and_effect_is_a_value() -> None:
    wanted = {*classes(), *get_args(Event), *get_args(Effect)}
    assert sorted(each.__name__ for each in wanted if not is_dataclass(each)) == []


def test_a_name_of_the_package_is_loaded_on_first_use() -> None:
    """Otherwise a command that needs no kernel would load all of it."""
    assert set(kernel.__all__).isdisjoint(vars(kernel))
    assert all(getattr(kernel, name).__name__ for name in ("Kernel", "Tick", "to_json"))


def test_every_value_is_found() -> None:
    names = {kind.__name__ for kind in values()}
    assert names > {"State", "Health", "KernelParams", "Tick", "Reply", "Drive", "Line", "Rule"}


@pytest.mark.parametrize("kind", values(), ids=lambda kind: kind.__name__)
def test_a_value_cannot_be_changed(kind: type) -> None:
    assert vars(kind)["__dataclass_params__"].frozen
    value: object = object.__new__(kind)
    for field in fields(kind):
        with pytest.raises(FrozenInstanceError):
            setattr(value, field.name, 0)


@pytest.mark.parametrize("kind", values(), ids=lambda kind: kind.__name__)
def test_a_value_has_its_fields_and_no_more(kind: type) -> None:
    if kind in (State, Health, Drive):  # copied by `changed`, through their dictionaries
        with pytest.raises(AssertionError, match="another"):
            changed(cast(Any, object.__new__(kind)), another=0)
    else:
        assert not hasattr(object.__new__(kind), "__dict__")
