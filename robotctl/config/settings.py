"""Read and change a configuration by the dotted keys that a file uses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches
from enum import Enum
from functools import cache
from reprlib import repr as short_repr
from typing import Any, get_type_hints

from robotctl.config.schema import Config
from robotctl.config.values import checked_value, not_allowed
from robotctl.errors import ConfigError
from robotctl.kernel.params import KernelParams


def check_together(kernel: KernelParams) -> None:
    """Check values against one another.

    Raises:
        ConfigError: Two values are allowed separately, but not together.
    """
    battery, two_periods_s = kernel.battery, 2.0 / kernel.rate_hz
    taken: dict[str, str] = {}
    for part in ("command", "odometry", "battery"):
        key, name = f"{part}.topic", getattr(kernel, part).topic
        other = taken.setdefault(name.removeprefix("/"), key)
        if name and other != key:
            raise not_allowed(key, name, f"{other} is the same topic, use another one")
    if battery.clear_level < battery.stop_level:
        raise not_allowed(
            "battery.clear_level",
            battery.clear_level,
            f"use at least battery.stop_level, {battery.stop_level:g}",
        )
    if kernel.max_tick_gap_s < two_periods_s:
        raise not_allowed(
            "max_tick_gap_s",
            kernel.max_tick_gap_s,
            f"use at least two periods of rate_hz, {two_periods_s:g} s",
        )


def with_setting(config: Config, key: str, value: object) -> Config:
    """Return `config` with the dotted `key` set to `value`.

    Raises:
        ConfigError: There is no such key, or the value is not allowed.
    """
    known = dict(_leaves(config))
    if key not in known:
        near = get_close_matches(key, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"use {', '.join(sorted(known))}"
        shown = key if key.isprintable() and len(key) <= 80 else short_repr(key)
        raise ConfigError(f"{shown}: no such key", hint)
    path = known[key]
    replaced = _replaced(config, path, key, value)
    assert isinstance(replaced, Config)
    return replaced


def check_all(config: Config) -> None:
    """Check every value of a configuration that was not read by `load`.

    Raises:
        ConfigError: A value is not allowed.
    """
    paths = dict(_leaves(config))
    for key, value in flat(config).items():
        _replaced(config, paths[key], key, value)
    check_together(config.kernel)


def with_text(config: Config, key: str, text: str) -> Config:
    """Return `config` with the dotted `key` set to a value typed on a command line.

    Raises:
        ConfigError: There is no such key, or the value is not allowed.
    """
    kind = type(flat(config).get(key))
    value: object = text
    if kind is bool:
        value = {"true": True, "false": False}.get(text.lower(), text)
    elif kind in (int, float):
        with suppress(ValueError):
            value = kind(text)
    return with_setting(config, key, value)


def flat(config: Config) -> dict[str, object]:
    """Return every dotted key with its value, in the form that a file uses."""
    values: dict[str, object] = {}
    for key, path in _leaves(config):
        value: Any = config
        for name in path:
            value = getattr(value, name)
        values[key] = _as_in_file(value)
    return values


def _as_in_file(value: Any) -> object:
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def _leaves(config: Config) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each dotted key with the path of attributes that leads to its value."""

    def walk(section: Any, path: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
        for item in fields(section):
            value = getattr(section, item.name)
            if is_dataclass(value):
                yield from walk(value, (*path, item.name))
            else:
                names = (*path, item.name)
                yield ".".join(names[1:] if names[0] == "kernel" else names), names

    return walk(config, ())


@cache
def _kinds(section: type) -> dict[str, Any]:
    """Return the type of each field of a section."""
    return get_type_hints(section)


def _replaced(section: Any, path: tuple[str, ...], key: str, value: object) -> Any:
    """Return `section` with the attribute at `path` replaced by the checked `value`."""
    name = path[0]
    if len(path) > 1:
        return replace(section, **{name: _replaced(getattr(section, name), path[1:], key, value)})
    (item,) = (item for item in fields(section) if item.name == name)
    kind = _kinds(section.__class__)[name]
    return replace(section, **{name: checked_value(key, value, kind, item.metadata)})
