"""The daemon's configuration: frozen, and validated once, where it comes in.

A file is YAML, nested or with dotted keys, plain or in the form of a ROS parameter file:

    tracking.k_y: 8.0                     robot:
    limits: {linear_mps: 0.3}               ros__parameters:
                                              tracking.k_y: 8.0

Anchors and aliases are refused: a file of a few lines could grow beyond memory with them.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from enum import Enum
from functools import cache
from pathlib import Path
from reprlib import repr as short_repr
from typing import Any, get_type_hints

from robotctl.errors import ConfigError
from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Range, bounded
from robotctl.regular_file import open_regular
from robotctl.sim.robot import SimParams

MAX_FILE_BYTES = 1_000_000
"""A longer file is not a configuration."""


_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_PATTERN = re.compile(r"(?:type:|(?=[/*?\[]))[A-Za-z0-9_/*?!\[\]-]{1,300}")
PATTERN_HELP = "a topic (/scan), a glob (/camera/*) or a type (type:sensor_msgs/msg/Image)"


@dataclass(frozen=True, slots=True)
class RecordingParams:
    """How traffic is recorded, and for how long.

    `compression` is zstd or none. The oldest recordings are removed until no more than
    `max_total_gb` are left and none is older than `max_age_days`; 0 keeps all. Of the topics
    those are recorded that a pattern of `include` matches, all where there is none, but for those
    that a pattern of `exclude` matches. A clip is cut out around each emergency stop and error,
    from `clip_before_s` before it to `clip_after_s` after it; none where `clip_before_s` is 0. The
    group may read the recordings if `group_readable`, else their owner alone.
    """

    compression: str = field(default="zstd", metadata={"choices": ("zstd", "none")})
    max_total_gb: float = bounded(20.0, 0.0, 1e6, "GB")
    max_age_days: float = bounded(30.0, 0.0, 1e5, "days")
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    clip_before_s: float = bounded(30.0, 0.0, 3600.0, "s")
    clip_after_s: float = bounded(5.0, 0.0, 600.0, "s")
    group_readable: bool = False


@dataclass(frozen=True, slots=True)
class Config:
    """Everything that a file may set. The kernel's parameters have no prefix in the file.

    `fifo_priority` asks for SCHED_FIFO for the thread of the loop, from 1 (low) to 99; 0 does not.
    `on_recorder_failure` says whether a robot that nothing records any more has to stop.
    """

    kernel: KernelParams = field(default_factory=KernelParams)
    sim: SimParams = field(default_factory=SimParams)
    recording: RecordingParams = field(default_factory=RecordingParams)
    fifo_priority: int = bounded(0, 0, 99)
    on_recorder_failure: str = field(default="stop", metadata={"choices": ("stop", "warn")})


def load(path: Path) -> Config:
    """Return the configuration in `path`.

    Raises ConfigError, which names file, key, value and what is allowed.
    """
    settings = _flatten(_parameters(_read(path), path), path)
    config = Config()
    seen: set[str] = set()
    try:
        for key, value in settings:
            if key in seen:
                raise ConfigError(f"{key}: stands twice", "keep one of them")
            seen.add(key)
            config = with_setting(config, key, value)
        check_together(config.kernel)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error.cause}", error.cure) from None
    return config


def check_together(kernel: KernelParams) -> None:
    """Raise ConfigError for values that are each allowed, but not with one another."""
    battery, two_periods_s = kernel.battery, 2.0 / kernel.rate_hz
    taken: dict[str, str] = {}
    for part in ("command", "odometry", "battery"):
        key, name = f"{part}.topic", getattr(kernel, part).topic
        other = taken.setdefault(name.removeprefix("/"), key)
        if name and other != key:
            raise _not_allowed(key, name, f"{other} has it already, use another topic")
    if battery.clear_level < battery.stop_level:
        raise _not_allowed(
            "battery.clear_level",
            battery.clear_level,
            f"use at least battery.stop_level, {battery.stop_level:g}",
        )
    if kernel.max_tick_gap_s < two_periods_s:
        raise _not_allowed(
            "max_tick_gap_s",
            kernel.max_tick_gap_s,
            f"use at least two periods of rate_hz, {two_periods_s:g} s",
        )


def with_setting(config: Config, key: str, value: object) -> Config:
    """Return `config` with the dotted `key` set; raises ConfigError where that is not allowed."""
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
    """Raise ConfigError where a value is not allowed; for what did not come through `load`."""
    paths = dict(_leaves(config))
    for key, value in flat(config).items():
        _replaced(config, paths[key], key, value)
    check_together(config.kernel)


def with_text(config: Config, key: str, text: str) -> Config:
    """As `with_setting`, with the value as it is typed on a command line. Raises ConfigError."""
    kind = type(flat(config).get(key))
    value: object = text
    if kind is bool:
        value = {"true": True, "false": False}.get(text.lower(), text)
    elif kind in (int, float):
        with suppress(ValueError):
            value = kind(text)
    return with_setting(config, key, value)


def flat(config: Config) -> dict[str, object]:
    """Return every key with its value, as a file would name them."""
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
    """Yield each key with the attributes that lead to it."""

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
    """The type of each field of a section."""
    return get_type_hints(section)


def _replaced(section: Any, path: tuple[str, ...], key: str, value: object) -> Any:
    name = path[0]
    if len(path) > 1:
        return replace(section, **{name: _replaced(getattr(section, name), path[1:], key, value)})
    (item,) = (item for item in fields(section) if item.name == name)
    kind = _kinds(section.__class__)[name]
    return replace(section, **{name: _checked(key, value, kind, item.metadata)})


def _checked(key: str, value: object, kind: Any, metadata: Mapping[str, Any]) -> object:
    if kind == tuple[str, ...]:
        return _checked_patterns(key, value)
    if issubclass(kind, Enum):
        choices = {member.value: member for member in kind}
        if type(value) in (str, int) and str(value) in choices:  # 100 is an int in YAML
            return choices[str(value)]
        raise _not_allowed(key, value, f"use {', '.join(choices)}")
    if kind is float:
        low, high, unit = metadata.get("range", Range(-1e12, 1e12))
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise _not_allowed(key, value, f"use a number from {low:g} to {high:g} {unit}".rstrip())
        if not low <= value <= high:  # so is NaN
            raise _not_allowed(key, value, f"use {low:g} to {high:g} {unit}".rstrip())
        return float(value)
    if "choices" in metadata and value not in metadata["choices"]:
        raise _not_allowed(key, value, f"use {', '.join(metadata['choices'])}")
    if metadata.get("topic") and not _is_topic(value, optional=metadata["optional"]):
        none = ', or "" for none' if metadata["optional"] else ""
        raise _not_allowed(key, value, f"use the name of a ROS topic, such as /a/b{none}")
    if type(value) is not kind:
        names = {int: "a whole number", str: "a text", bool: "true or false"}
        raise _not_allowed(key, value, f"use {names[kind]}")
    if isinstance(value, int) and "range" in metadata:
        low, high, _ = metadata["range"]
        if not low <= value <= high:
            raise _not_allowed(key, value, f"use {low} to {high}")
    return value


def _checked_patterns(key: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise _not_allowed(key, value, f"use a list, each {PATTERN_HELP}")
    for pattern in value:
        if not is_topic_pattern(pattern):
            raise _not_allowed(key, pattern, f"use {PATTERN_HELP}")
    return tuple(value)


def is_topic_pattern(value: object) -> bool:
    """Say whether a text can name topics: it is PATTERN_HELP."""
    return isinstance(value, str) and _PATTERN.fullmatch(value) is not None


def _is_topic(value: object, *, optional: bool) -> bool:
    if not isinstance(value, str):
        return False
    if not value:
        return optional
    return _TOPIC.fullmatch(value) is not None and "__" not in value and len(value) <= 200


def _not_allowed(key: str, value: object, allowed: str) -> ConfigError:
    return ConfigError(f"{key}: {short_repr(value)} is not allowed", allowed)


def _read(path: Path) -> Any:
    import yaml  # 15 ms that only a daemon with a configuration file pays

    class Loader(yaml.SafeLoader):
        """Refuses aliases, and a key that stands twice: YAML would silently keep the last."""

        def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are not supported: write the value itself")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
            seen: set[Hashable] = set()
            for item, _ in node.value:
                key = self.construct_object(item, deep=True)
                if key in seen:
                    raise yaml.YAMLError(f"{short_repr(key)}: stands twice: keep one of them")
                seen.add(key)
            return super().construct_mapping(node, deep)

    try:
        with open_regular(path) as file:
            text = file.read(MAX_FILE_BYTES + 1)
        if len(text) > MAX_FILE_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES} bytes: not a configuration")
        return yaml.load(text, Loader)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}", "give the path of a YAML file") from None
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None


def _parameters(content: Any, path: Path) -> Mapping[Any, Any]:
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: not a mapping of keys to values")
    if len(content) == 1:
        (inner,) = content.values()
        if isinstance(inner, dict) and list(inner) == ["ros__parameters"]:
            return _parameters(inner["ros__parameters"], path)
    return content


def _flatten(
    settings: Mapping[Any, Any], path: Path, prefix: str = ""
) -> Iterator[tuple[str, object]]:
    for name, value in settings.items():
        key = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _flatten(value, path, f"{key}.")
        else:
            yield key, value
