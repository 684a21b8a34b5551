"""The kernel's parameters by dotted keys, such as `limits.linear_mps`, with values as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import Field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from typing import Any, NamedTuple

from robotctl.kernel.params import Foreign, KernelParams, WhenIdle
from robotctl.kernel.safety_inputs import SafetyInput, Use

_WITH_TOPIC = ("command", "odometry", "battery")


class Leaf(NamedTuple):
    """A parameter: its attribute path, such as ("limits", "linear_mps"), and its declaration."""

    path: tuple[str, ...]
    declared: Field[Any]


class Conflict(NamedTuple):
    """A conflict of a parameter with another; `allowed` is advice such as "use at least 2 s"."""

    key: str
    value: object
    allowed: str


def leaves(section: Any, path: tuple[str, ...] = ()) -> Iterator[Leaf]:
    """Yield each parameter of `section` and of the dataclasses in it; `path` leads to `section`."""
    for item in fields(section):
        value = getattr(section, item.name)
        if is_dataclass(value):
            yield from leaves(value, (*path, item.name))
        else:
            yield Leaf((*path, item.name), item)


def value_at(section: Any, path: tuple[str, ...]) -> Any:
    """Return the value at the end of a path of attribute names."""
    for name in path:
        section = getattr(section, name)
    return section


def with_value(section: Any, path: tuple[str, ...], value: object) -> Any:
    """Return `section` with the value at `path` replaced."""
    name, *rest = path
    inner = with_value(getattr(section, name), tuple(rest), value) if rest else value
    return replace(section, **{name: inner})


def text_of(value: object) -> str:
    """Return `value` as text, in the form that `ParameterRequested` has."""
    return str(value.value if isinstance(value, Enum) else value)


@cache
def kernel_leaves() -> Mapping[str, Leaf]:
    """Return every parameter of the kernel by its key."""
    return {".".join(leaf.path): leaf for leaf in leaves(KernelParams())}


def with_text(params: KernelParams, key: str, text: str) -> KernelParams:
    """Return `params` with the parameter `key` set to the value of `text`.

    Raises:
        ValueError: The value is not allowed.
        KeyError: The kernel has no such parameter.
    """
    leaf = kernel_leaves()[key]
    before = value_at(params, leaf.path)
    value: object = type(before)(text)
    allowed = leaf.declared.metadata.get("range")
    if allowed is not None and not (
        isinstance(value, float) and allowed.low <= value <= allowed.high
    ):
        raise ValueError(f"{key}: {text} is not from {allowed.low:g} to {allowed.high:g}")
    changed: KernelParams = with_value(params, leaf.path, value)
    return changed


def conflict(params: KernelParams) -> Conflict | None:
    """Return the first conflict between two parameters, None if there is no conflict."""
    battery, two_periods_s = params.battery, 2.0 / params.rate_hz
    taken: dict[str, str] = {}
    topics = {f"{part}.topic": getattr(params, part).topic for part in _WITH_TOPIC}
    for kind in SafetyInput:
        if (wanted := params.inputs.of(kind)).use is not Use.OFF:
            topics[f"inputs.{kind.value}.topic"] = wanted.topic
    if params.scan.use is not Use.OFF:
        topics["scan.topic"] = params.scan.topic
    if params.guard:
        topics["guard_topic"] = params.guard_topic
    topics["command.lock_topic"] = params.command.lock_topic
    for key, name in topics.items():
        other = taken.setdefault(name.removeprefix("/"), key)
        if name and other != key:
            return Conflict(key, name, f"{other} is the same topic, use another one")
    command = params.command
    if command.foreign is Foreign.YIELD and command.when_idle is not WhenIdle.SILENT:
        return Conflict("command.foreign", "yield", "use command.when_idle silent with it")
    if battery.clear_level < battery.stop_level:
        allowed = f"use at least battery.stop_level, {battery.stop_level:g}"
        return Conflict("battery.clear_level", battery.clear_level, allowed)
    if params.max_tick_gap_s < two_periods_s:
        allowed = f"use at least two periods of rate_hz, {two_periods_s:g} s"
        return Conflict("max_tick_gap_s", params.max_tick_gap_s, allowed)
    return None
