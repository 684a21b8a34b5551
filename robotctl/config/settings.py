"""All settings with their defaults, by dotted keys or from a file.

A file is YAML, nested or with dotted keys, plain or in the form of a ROS parameter file:

    tracking.k_y: 8.0                     robot:
    limits: {linear_mps: 0.3}               ros__parameters:
                                              tracking.k_y: 8.0
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum
from functools import cache
from pathlib import Path
from reprlib import repr as short_repr
from typing import Any, Final, get_type_hints

from robotctl.base import retired
from robotctl.base.errors import ConfigError
from robotctl.base.files import open_regular
from robotctl.kernel.fence import corners_of
from robotctl.kernel.parameter_keys import Leaf, conflict, leaves, value_at, with_value
from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Change, Range, bounded, setting
from robotctl.recording.format.names import Compression
from robotctl.sim import SimParams


@dataclass(frozen=True, slots=True)
class RecordingParams:
    """The parameters of recordings.

    A topic is recorded if `include` is empty or has a pattern that matches it, unless a pattern of
    `exclude` matches the topic. A clip is a short recording of one emergency stop or error.
    """

    compression: Compression = setting(Compression.ZSTD, "compression of the chunks", Change.START)
    max_total_gb: float = bounded(20.0, 0.0, 1e6, "GB", "size of all recordings that are kept")
    """Beyond it, the oldest recordings that are not marked to be kept are removed; 0: no limit."""
    max_age_days: float = bounded(
        30.0, 0.0, 1e5, "days", "age of the oldest recording that is kept"
    )
    """Older recordings that are not marked to be kept are removed; 0: no limit."""
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
    """The retention of the journal of decisions; 0 means forever."""

    keep_years: float = bounded(
        5.0, 0.0, 100.0, "years", "how long the journal of decisions is kept", Change.START
    )


@dataclass(frozen=True, slots=True)
class SocketParams:
    """Clients that may give commands on the control socket, besides the socket's owner and root."""

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
    """The effect of a failed recording on the robot, a stop or only a warning."""
    on_topic_trouble: str = setting(
        "warn",
        "what a topic that is silent, slow or fast does to the start of a motion",
        Change.START,
        choices=("warn", "refuse"),
    )
    """With `refuse`, no motion starts while a topic has no messages or an unexpected rate."""


_TOPIC = re.compile(r"(?!.*__)(?=.{1,200}\Z)/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_FRAME = re.compile(r"[A-Za-z0-9_/]{1,200}")
_PATTERN = re.compile(r"(?:type:|(?=[/*?\[]))[A-Za-z0-9_/*?!\[\]-]{1,300}")
MAX_RATE_HZ = 1e5
RATES_HELP = 'use topics, globs or types with rates, such as {"/camera/*": 5}'
MAX_GROUP_NAME = 256

PATTERN_HELP = "a topic (/scan), a glob (/camera/*) or a type (type:sensor_msgs/msg/Image)"


def _are_corners(text: str) -> bool:
    try:
        return len(corners_of(text)) >= 0
    except ValueError:
        return False


_TEXTS: Final[Mapping[str, tuple[Callable[[str], object], str, str]]] = {
    "topic": (_TOPIC.fullmatch, "the name of a ROS topic, such as /a/b", ', or "" for none'),
    "frame": (_FRAME.fullmatch, "the name of a frame, such as base_link", ', or "" for any'),
    "group": (
        lambda text: text.isprintable() and len(text) <= MAX_GROUP_NAME,
        "the name of a Unix group",
        ', or "" for none',
    ),
    "corners": (_are_corners, "3 to 64 corners, such as 0,0 2,0 2,1", ""),
}
"""For each kind of text: its check, the allowed texts in words, and words for an allowed ""."""


def checked_value(key: str, value: object, kind: Any, metadata: Mapping[str, Any]) -> object:
    """Return the value of `key` in a file as the type `kind`, within the limits in `metadata`.

    Raises:
        ConfigError: The value is not allowed.
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
    for flag, (matches, text, none) in _TEXTS.items():
        optional = metadata.get("optional", True)
        if metadata.get(flag) and not (
            isinstance(value, str) and (matches(value) or (optional and not value))
        ):
            raise not_allowed(key, value, f"use {text}{none if optional else ''}")
    if type(value) is not kind:
        names = {int: "a whole number", str: "text", bool: "true or false"}
        raise not_allowed(key, value, f"use {names[kind]}")
    if isinstance(value, int) and "range" in metadata:
        low, high, _ = metadata["range"]
        if not low <= value <= high:
            raise not_allowed(key, value, f"use {low} to {high}")
    return value


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


def not_allowed(key: str, value: object, allowed: str) -> ConfigError:
    """Return the error that `value` is not allowed for `key`, with the advice `allowed`."""
    return ConfigError(f"{key}: {short_repr(value)} is not allowed", allowed)


log_warning: Callable[[str], object] = logging.getLogger(__name__).warning
"""The default for `warn` parameters, which only writes to the log."""


def check_together(kernel: KernelParams) -> None:
    """Raise ConfigError if two kernel parameters are allowed separately, but not together."""
    clash = conflict(kernel)
    if clash is not None:
        raise not_allowed(*clash)


def warn_of_retired(key: str, warn: Callable[[str], object], where: str = "") -> bool:
    """Return whether `key` is retired; if so, call `warn` with the text `where` and a sentence."""
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
    """Check every value of a configuration that a program made without `load`.

    Raises:
        ConfigError: A value is not allowed.
    """
    known = dict(keyed_leaves(config))
    for key, value in flat(config).items():
        _checked(config, key, known[key], value)
    check_together(config.kernel)


def with_text(config: Config, key: str, text: str) -> Config:
    """Return `config` with the dotted `key` set to the value of a command line's `text`.

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
    """Return every dotted key with its value in the form of a file."""
    return {key: as_in_file(value_at(config, leaf.path)) for key, leaf in keyed_leaves(config)}


def as_in_file(value: Any) -> object:
    """Return a setting's value without enum members and tuples, as in a configuration file."""
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def keyed_leaves(config: Config) -> Iterator[tuple[str, Leaf]]:
    """Yield each dotted key, without a leading `kernel.`, with the parameter that it names."""
    for leaf in leaves(config):
        yield ".".join(leaf.path[1:] if leaf.path[0] == "kernel" else leaf.path), leaf


RATE_KEYS = frozenset(
    key for key, leaf in keyed_leaves(Config()) if leaf.declared.metadata.get("rates")
)
"""The keys whose value in a file may be a mapping from topics to rates."""


@cache
def _kinds(section: Any) -> dict[str, Any]:
    """Return the type of each field of a dataclass."""
    return get_type_hints(section)


def _checked(config: Config, key: str, leaf: Leaf, value: object) -> Config:
    """Return `config` with a parameter set to the checked `value`."""
    section: Any = value_at(config, leaf.path[:-1])
    kind = _kinds(section.__class__)[leaf.path[-1]]
    checked = checked_value(key, value, kind, leaf.declared.metadata)
    changed: Config = with_value(config, leaf.path, checked)
    return changed


FileValue = bool | int | float | str | list[str]
"""A value in the form of a file."""


class Kind(Enum):
    """The type of a setting's value."""

    BOOLEAN = "boolean"
    INTEGER = "whole number"
    NUMBER = "number"
    TEXT = "text"
    TEXTS = "texts"


_KINDS = {bool: Kind.BOOLEAN, int: Kind.INTEGER, float: Kind.NUMBER, str: Kind.TEXT}


@dataclass(frozen=True, slots=True)
class Declaration:
    """A parameter's key, type, default and help; `range` is None except for bounded numbers."""

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


_IN_WORDS: Final = {
    "rates": "topics, globs, types, each with a rate",
    "corners": '3 to 64 corners; "" for none',
    "topic": 'a topic; "" for none',
    "command": 'a command line; "" for none',
    "group": 'a Unix group; "" for none',
    "frame": 'the name of a frame; "" for any',
}


def _allowed(value: object, metadata: Mapping[str, Any]) -> str:
    """Return the allowed values in words."""
    limits = metadata.get("range")
    if limits is not None:
        return f"{limits.low:g} to {limits.high:g} {limits.unit}".rstrip()
    if isinstance(value, Enum):
        return ", ".join(member.value for member in type(value))
    if "choices" in metadata:
        return ", ".join(metadata["choices"])
    for flag, words in _IN_WORDS.items():
        if metadata.get(flag):
            return words if metadata.get("optional", True) else words.partition(";")[0]
    if isinstance(value, bool):
        return "true, false"
    return "a whole number" if isinstance(value, int) else "a list of topics, globs, types"


MAX_FILE_BYTES = 1_000_000
"""The size of the largest file that is read."""


def load(path: Path, warn: Callable[[str], object] = log_warning) -> Config:
    """Return the configuration in the file `path`; call `warn` for each retired key, and skip it.

    Raises:
        ConfigError: The file cannot be read, or a key or value is not allowed.
    """
    config = Config()
    for key, value in read_settings(path):
        if warn_of_retired(key, warn, f"{path}: "):
            continue
        try:
            config = with_setting(config, key, value)
        except ConfigError as error:
            raise file_error(path, key, error) from None
    try:
        check_together(config.kernel)
    except ConfigError as error:
        raise file_error(path, error.cause.partition(":")[0], error) from None
    return config


def read_settings(path: Path) -> list[tuple[str, object]]:
    """Return each dotted key of a file with its value, unchecked and in the file's order.

    Raises:
        ConfigError: The file cannot be read, or has a key twice.
    """
    settings = list(flatten(_parameters(read_yaml(path), path)))
    seen: set[str] = set()
    for key, _ in settings:
        if key in seen:
            raise file_error(path, key, ConfigError(f"{key}: is given twice", "keep one of them"))
        seen.add(key)
    return settings


def file_error(path: Path, key: str, error: ConfigError) -> ConfigError:
    """Return `error` with the path of the file and, if found, the number of the line with `key`."""
    line = _line_of(path, key)
    where = f"{path}: " if line is None else f"{path}: line {line}: "
    return ConfigError(f"{where}{error.cause}", error.cure)


def read_value(name: str, text: str) -> object:
    """Return the value of the YAML `text`; the text of an error begins with `name`.

    Raises:
        ConfigError: The text is not valid YAML.
    """
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise ConfigError(f"{name}: not valid YAML: {' '.join(str(error).split())}") from None


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        ConfigError: The file cannot be read, is not valid YAML, or has aliases or duplicate keys.
    """
    import yaml  # here: the import takes 15 ms, and most daemons have no configuration file

    class Loader(yaml.SafeLoader):
        """Refuses aliases, which could expand beyond the memory, and duplicate keys."""

        def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are not supported: write the value itself")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
            seen: set[Hashable] = set()
            for item, _ in node.value:
                key = self.construct_object(item, deep=True)
                if key in seen:
                    raise yaml.YAMLError(f"{short_repr(key)}: is given twice: keep one of them")
                seen.add(key)
            return super().construct_mapping(node, deep)

    try:
        return yaml.load(_text(path), Loader)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}", "give the path of a YAML file") from None
    except (yaml.YAMLError, RecursionError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None


def _text(path: Path) -> bytes:
    with open_regular(path) as file:
        text = file.read(MAX_FILE_BYTES + 1)
    if len(text) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_FILE_BYTES} bytes, not a configuration")
    return text


def _line_of(path: Path, key: str) -> int | None:
    """Return the number of the last line with the dotted `key`, None if it is not found."""
    import yaml

    def lines(node: yaml.Node | None, prefix: str) -> Iterator[tuple[str, int]]:
        for name, value in node.value if isinstance(node, yaml.MappingNode) else ():
            yield f"{prefix}{name.value}", name.start_mark.line + 1
            yield from lines(value, f"{prefix}{name.value}.")

    try:
        named = lines(yaml.compose(_text(path), yaml.SafeLoader), "")
        found = [line for name, line in named if f".{name}".endswith(f".{key}")]
    except (OSError, yaml.YAMLError):  # the file was changed meanwhile
        return None
    return found[-1] if found else None


def _parameters(content: Any, path: Path) -> Mapping[Any, Any]:
    """Return the settings of a file; in a ROS parameter file, they are below `ros__parameters`."""
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: not a mapping of keys to values")
    if len(content) == 1:
        (inner,) = content.values()
        if isinstance(inner, dict) and list(inner) == ["ros__parameters"]:
            return _parameters(inner["ros__parameters"], path)
    return content


def flatten(settings: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield (dotted key, value) of nested settings. A mapping of rates by topic is one value."""
    for name, value in settings.items():
        key = f"{prefix}{name}"
        if isinstance(value, dict) and key not in RATE_KEYS:
            yield from flatten(value, f"{key}.")
        else:
            yield key, value
