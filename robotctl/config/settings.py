"""Read and change a configuration by the dotted keys that a file uses."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import suppress
from difflib import get_close_matches
from enum import Enum
from functools import cache
from reprlib import repr as short_repr
from typing import Any, get_type_hints

from robotctl import retired
from robotctl.config.allowed_values import checked_value, not_allowed
from robotctl.config.schema import Config
from robotctl.errors import ConfigError
from robotctl.kernel.parameters import Leaf, conflict, leaves, value_at, with_value
from robotctl.kernel.params import KernelParams

_log = logging.getLogger(__name__)


def check_together(kernel: KernelParams) -> None:
    """Check values against one another.

    Raises:
        ConfigError: Two values are allowed separately, but not together.
    """
    clash = conflict(kernel)
    if clash is not None:
        raise not_allowed(*clash)


def warn_of_retired(key: str, where: str = "") -> bool:
    """Return whether an earlier version had this key; log what replaces it, if so.

    `where` is the beginning of the warning.
    """
    instead = retired.CONFIG_KEYS.get(key)
    if instead is not None:
        _log.warning("%s%s is retired and ignored: %s", where, key, instead)
    return instead is not None


def with_setting(config: Config, key: str, value: object) -> Config:
    """Return `config` with the dotted `key` set to `value`.

    Raises:
        ConfigError: There is no such key, or the value is not allowed.
    """
    known = dict(keyed_leaves(config))
    if key in retired.CONFIG_KEYS:
        raise ConfigError(f"{key} is retired", retired.CONFIG_KEYS[key])
    if key not in known:
        near = get_close_matches(key, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"use {', '.join(sorted(known))}"
        shown = key if key.isprintable() and len(key) <= 80 else short_repr(key)
        raise ConfigError(f"{shown}: no such key", hint)
    return _checked(config, key, known[key], value)


def check_all(config: Config) -> None:
    """Check every value of a configuration that was not read by `load`.

    Raises:
        ConfigError: A value is not allowed.
    """
    known = dict(keyed_leaves(config))
    for key, value in flat(config).items():
        _checked(config, key, known[key], value)
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
    return {key: as_in_file(value_at(config, leaf.path)) for key, leaf in keyed_leaves(config)}


def as_in_file(value: Any) -> object:
    """Return a value in the form that a file uses."""
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def keyed_leaves(config: Config) -> Iterator[tuple[str, Leaf]]:
    """Yield each parameter with its dotted key; those of the kernel have no prefix."""
    for leaf in leaves(config):
        yield ".".join(leaf.path[1:] if leaf.path[0] == "kernel" else leaf.path), leaf


RATE_KEYS = frozenset(
    key for key, leaf in keyed_leaves(Config()) if leaf.declared.metadata.get("rates")
)
"""The keys whose value is a mapping of topics to rates."""


@cache
def _kinds(section: Any) -> dict[str, Any]:
    """Return the type of each field of a section."""
    return get_type_hints(section)


def _checked(config: Config, key: str, leaf: Leaf, value: object) -> Config:
    """Return `config` with a parameter set to the checked `value`."""
    section: Any = value_at(config, leaf.path[:-1])
    kind = _kinds(section.__class__)[leaf.path[-1]]
    checked = checked_value(key, value, kind, leaf.declared.metadata)
    changed: Config = with_value(config, leaf.path, checked)
    return changed
