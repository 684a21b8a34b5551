"""Read and change a configuration by the dotted keys that a file uses."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum
from functools import cache
from reprlib import repr as short_repr
from typing import Any, get_type_hints

from robotctl.base import retired
from robotctl.base.errors import ConfigError
from robotctl.kernel.fence import corners_of
from robotctl.kernel.parameter_keys import Leaf, conflict, leaves, value_at, with_value
from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Change, Range, bounded, setting
from robotctl.recording.format.names import Compression
from robotctl.sim import SimParams


@dataclass(frozen=True, slots=True)
class RecordingParams:
    """What is recorded, and how long recordings are kept.

    A topic is recorded if `include` is empty or has a pattern that matches it, unless a pattern of
    `exclude` matches the topic. A clip is cut around each emergency stop and each error.
    """

    compression: Compression = setting(Compression.ZSTD, "compression of the chunks", Change.START)
    max_total_gb: float = bounded(20.0, 0.0, 1e6, "GB", "size of all recordings that are kept")
    """Beyond it, the oldest recordings are removed, except those marked to be kept; 0: no limit."""
    max_age_days: float = bounded(
        30.0, 0.0, 1e5, "days", "age of the oldest recording that is kept"
    )
    """Older recordings are removed, except those marked to be kept; 0: no limit."""
    include: tuple[str, ...] = setting((), "topics that are recorded", Change.START)
    exclude: tuple[str, ...] = setting((), "topics that are not recorded", Change.START)
    clip_before_s: float = bounded(
        30.0, 0.0, 3600.0, "s", "what a clip holds before its event; 0: no clips"
    )
    clip_after_s: float = bounded(5.0, 0.0, 600.0, "s", "what a clip holds after its event")
    throttle: tuple[str, ...] = setting(
        (), "messages a second that are recorded at most, by topic", Change.START, rates=True
    )
    """Texts PATTERN=RATE, as in `expected_rates`; the first pattern that matches a topic counts."""
    expected_rates: tuple[str, ...] = setting(
        (),
        "messages a second that are expected, by topic; 0: no expectation",
        Change.START,
        rates=True,
    )
    min_free_gb: float = bounded(
        0.0,
        0.0,
        1e6,
        "GB",
        "with less free on the disk, the heaviest topics are not recorded; 0: off",
        Change.START,
    )
    index: bool = setting(True, "index a closed recording; needs robotctl[parquet]")
    group_readable: bool = setting(False, "the group may read (0640, 0750)", Change.START)
    """If this is not set, only the owner of a recording may read it."""
    foxglove_events: bool = setting(
        False, "changes of the mode and marks are recorded as events of Foxglove", Change.START
    )
    seal: bool = setting(True, "sign the recordings with the robot's key", Change.START)
    publish_heads: bool = setting(
        False, "publish the newest head of the seal on robotctl/head", Change.START
    )
    head_command: str = setting(
        "", "program that gets each new head of the seal as an argument", Change.START, command=True
    )


@dataclass(frozen=True, slots=True)
class DecisionParams:
    """How long the journal of decisions is kept; 0 means forever."""

    keep_years: float = bounded(
        5.0, 0.0, 100.0, "years", "how long the journal of decisions is kept", Change.START
    )


@dataclass(frozen=True, slots=True)
class SocketParams:
    """Who may give commands on the control socket, besides the socket's owner and root."""

    group: str = setting(
        "", "Unix group whose members may give every command (0660, 0750)", Change.START, group=True
    )


@dataclass(frozen=True, slots=True)
class Config:
    """Every setting. In a file, the kernel's parameters have no prefix."""

    kernel: KernelParams = field(default_factory=KernelParams)
    sim: SimParams = field(default_factory=SimParams)
    recording: RecordingParams = field(default_factory=RecordingParams)
    decisions: DecisionParams = field(default_factory=DecisionParams)
    socket: SocketParams = field(default_factory=SocketParams)
    fifo_priority: int = bounded(
        0, 0, 99, about="SCHED_FIFO priority of the loop's thread", change=Change.START
    )
    """From 1 (low) to 99; 0 leaves the scheduling as it is."""
    autostart: bool = setting(True, "mode_service configures and activates itself", Change.START)
    on_recorder_failure: str = setting(
        "stop", "what a failed recorder does", choices=("stop", "warn")
    )
    """Whether the robot must stop when recording fails, or only a warning is given."""
    on_topic_trouble: str = setting(
        "warn",
        "what a topic that is silent, slow or fast does to the start of a motion",
        Change.START,
        choices=("warn", "refuse"),
    )
    """Whether such a topic, if it is of another node, causes a warning or refuses the start."""


_TOPIC = re.compile(r"(?!.*__)(?=.{1,200}\Z)/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_FRAME = re.compile(r"[A-Za-z0-9_/]{1,200}")
_PATTERN = re.compile(r"(?:type:|(?=[/*?\[]))[A-Za-z0-9_/*?!\[\]-]{1,300}")
MAX_RATE_HZ = 1e5
RATES_HELP = 'use topics, globs or types with rates, such as {"/camera/*": 5}'
MAX_GROUP_NAME = 256
"""Limit on the length of a group's name; no name in group(5) or a directory service is longer."""

PATTERN_HELP = "a topic (/scan), a glob (/camera/*) or a type (type:sensor_msgs/msg/Image)"


def checked_value(key: str, value: object, kind: Any, metadata: Mapping[str, Any]) -> object:
    """Return `value` as a `kind`, the type of `key`; `metadata` is from the dataclass field.

    Raises:
        ConfigError: The value is not allowed; the error says which values are.
    """
    if kind == tuple[str, ...]:
        return (_checked_rates if metadata.get("rates") else _checked_patterns)(key, value)
    if issubclass(kind, Enum):
        choices = {member.value: member for member in kind}
        # YAML reads 100 and true as int and bool, not as text.
        if type(value) in (str, int, bool) and (text := str(value).lower()) in choices:
            return choices[text]
        raise not_allowed(key, value, f"use {', '.join(choices)}")
    if kind is float:
        low, high, unit = metadata.get("range", Range(-1e12, 1e12))
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise not_allowed(key, value, f"use a number from {low:g} to {high:g} {unit}".rstrip())
        if not low <= value <= high:  # NaN is refused, too
            raise not_allowed(key, value, f"use {low:g} to {high:g} {unit}".rstrip())
        return float(value)
    if "choices" in metadata and value not in metadata["choices"]:
        raise not_allowed(key, value, f"use {', '.join(metadata['choices'])}")
    if metadata.get("topic") and not _matches(_TOPIC, value, optional=metadata["optional"]):
        none = ', or "" for none' if metadata["optional"] else ""
        raise not_allowed(key, value, f"use the name of a ROS topic, such as /a/b{none}")
    if metadata.get("frame") and not _matches(_FRAME, value, optional=metadata["optional"]):
        none = ', or "" for any' if metadata["optional"] else ""
        raise not_allowed(key, value, f"use the name of a frame, such as base_link{none}")
    if metadata.get("group") and not (
        isinstance(value, str) and value.isprintable() and len(value) <= MAX_GROUP_NAME
    ):
        raise not_allowed(key, value, 'use the name of a Unix group, or "" for none')
    if metadata.get("corners") and not _are_corners(value):
        raise not_allowed(key, value, "use 3 to 64 corners, such as 0,0 2,0 2,1")
    if type(value) is not kind:
        names = {int: "a whole number", str: "text", bool: "true or false"}
        raise not_allowed(key, value, f"use {names[kind]}")
    if isinstance(value, int) and "range" in metadata:
        low, high, _ = metadata["range"]
        if not low <= value <= high:
            raise not_allowed(key, value, f"use {low} to {high}")
    return value


def _are_corners(value: object) -> bool:
    try:
        return isinstance(value, str) and len(corners_of(value)) >= 0
    except ValueError:
        return False


def _checked_patterns(key: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise not_allowed(key, value, f"use a list, each {PATTERN_HELP}")
    for pattern in value:
        if not is_topic_pattern(pattern):
            raise not_allowed(key, pattern, f"use {PATTERN_HELP}")
    return tuple(value)


def _checked_rates(key: str, value: object) -> tuple[str, ...]:
    """Return checked rates by topic as PATTERN=RATE; in a file, `value` may be a mapping."""
    if isinstance(value, dict):
        value = [f"{pattern}={rate}" for pattern, rate in value.items()]
    if not isinstance(value, list):
        raise not_allowed(key, value, RATES_HELP)
    for each in value:
        pattern, _, rate = each.rpartition("=") if isinstance(each, str) else ("", "", "")
        if not (is_topic_pattern(pattern) and _is_rate(rate)):
            raise not_allowed(key, each, RATES_HELP)
    return tuple(value)


def _is_rate(text: str) -> bool:
    try:
        return 0.0 <= float(text) <= MAX_RATE_HZ
    except ValueError:
        return False


def is_topic_pattern(value: object) -> bool:
    """Return whether the value is a topic, glob or type that can select topics."""
    return isinstance(value, str) and _PATTERN.fullmatch(value) is not None


def _matches(pattern: re.Pattern[str], value: object, *, optional: bool) -> bool:
    """Return whether a text matches; `optional` allows the empty text, too."""
    return isinstance(value, str) and bool(pattern.fullmatch(value) or (optional and not value))


def not_allowed(key: str, value: object, allowed: str) -> ConfigError:
    """Return the error for a value that is not allowed; `allowed` says what to use."""
    return ConfigError(f"{key}: {short_repr(value)} is not allowed", allowed)


log_warning: Callable[[str], object] = logging.getLogger(__name__).warning
"""The default for `warn` parameters: the warning only goes to the log."""


def check_together(kernel: KernelParams) -> None:
    """Check that no two parameters of the kernel conflict.

    Raises:
        ConfigError: Two values are allowed separately, but not together.
    """
    clash = conflict(kernel)
    if clash is not None:
        raise not_allowed(*clash)


def warn_of_retired(key: str, warn: Callable[[str], object], where: str = "") -> bool:
    """Return whether `key` is retired; if so, call `warn` with a text that begins with `where`."""
    instead = retired.CONFIG_KEYS.get(key)
    if instead is not None:
        warn(f"{where}{key} is retired and ignored: {instead}")
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
    """Check every value of a configuration that a program made, and not `load`.

    Raises:
        ConfigError: A value is not allowed.
    """
    known = dict(keyed_leaves(config))
    for key, value in flat(config).items():
        _checked(config, key, known[key], value)
    check_together(config.kernel)


def with_text(config: Config, key: str, text: str) -> Config:
    """Return `config` with the dotted `key` set to the value that a command line gives as text.

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
    """Yield each dotted key with its parameter; keys of the kernel's parameters have no prefix."""
    for leaf in leaves(config):
        yield ".".join(leaf.path[1:] if leaf.path[0] == "kernel" else leaf.path), leaf


RATE_KEYS = frozenset(
    key for key, leaf in keyed_leaves(Config()) if leaf.declared.metadata.get("rates")
)
"""The keys whose value in a file may be a mapping from topics to rates."""


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


FileValue = bool | int | float | str | list[str]
"""A value in the form that a file uses."""


class Kind(Enum):
    """The type of a value."""

    BOOLEAN = "boolean"
    INTEGER = "whole number"
    NUMBER = "number"
    TEXT = "text"
    TEXTS = "texts"


_KINDS = {bool: Kind.BOOLEAN, int: Kind.INTEGER, float: Kind.NUMBER, str: Kind.TEXT}


@dataclass(frozen=True, slots=True)
class Declaration:
    """Describes one parameter; `range` is None unless the parameter is a number with limits."""

    key: str
    kind: Kind
    default: FileValue
    about: str
    allowed: str
    change: Change
    range: Range | None


@cache
def declarations() -> Mapping[str, Declaration]:
    """Return the declaration of every key, in the order of the fields of `Config`."""
    config = Config()
    found = {}
    for key, leaf in keyed_leaves(config):
        value, metadata = value_at(config, leaf.path), leaf.declared.metadata
        default: Any = as_in_file(value)
        found[key] = Declaration(
            key,
            _KINDS.get(type(default), Kind.TEXTS),
            default,
            metadata["about"],
            _allowed(value, metadata),
            metadata["change"],
            metadata.get("range"),
        )
    return found


def _allowed(value: object, metadata: Mapping[str, Any]) -> str:
    """Return in words which values are allowed."""
    limits = metadata.get("range")
    if limits is not None:
        return f"{limits.low:g} to {limits.high:g} {limits.unit}".rstrip()
    if isinstance(value, Enum):
        return ", ".join(member.value for member in type(value))
    if "choices" in metadata:
        return ", ".join(metadata["choices"])
    if metadata.get("rates"):
        return "topics, globs, types, each with a rate"
    if metadata.get("corners"):
        return '3 to 64 corners; "" for none'
    if metadata.get("topic"):
        return 'a topic; "" for none' if metadata["optional"] else "a topic"
    if metadata.get("command"):
        return 'a command line; "" for none'
    if metadata.get("group"):
        return 'a Unix group; "" for none'
    if metadata.get("frame"):
        return 'the name of a frame; "" for any' if metadata["optional"] else "the name of a frame"
    if isinstance(value, bool):
        return "true, false"
    return "a whole number" if isinstance(value, int) else "a list of topics, globs, types"
