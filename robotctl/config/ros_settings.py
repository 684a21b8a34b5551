"""Applies `--ros-args` to a configuration: parameters, parameter files and remaps of topics."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

from robotctl.base import ros_arguments
from robotctl.base.errors import ConfigError, UsageError
from robotctl.base.ros_arguments import NO_ARGUMENTS, Assignment, Remap, RosArguments
from robotctl.config.settings import (
    Config,
    check_together,
    flat,
    flatten,
    keyed_leaves,
    log_warning,
    read_value,
    read_yaml,
    warn_of_retired,
    with_setting,
)

MODE_SERVICE: Final = "mode_service"
SIMULATED_ROBOT: Final = "simulated_robot"

PREFIXES: Final = {
    "velocity_publisher": (
        *("rate_hz", "max_tick_gap_s", "fifo_priority"),
        *("command.", "limits.", "tracking.", "pattern."),
    ),
    "odom_subscriber": ("odometry.",),
    SIMULATED_ROBOT: ("sim.",),
    MODE_SERVICE: ("",),
}
"""The key prefixes of each node; a key belongs to the first node with a matching prefix."""

NODES: Final = tuple(PREFIXES)


def node_of(key: str) -> str:
    """Return the name of the node that declares the parameter `key`."""
    return next(node for node, prefixes in PREFIXES.items() if key.startswith(prefixes))


_PARAMETERS = "ros__parameters"


class NodeParameter(NamedTuple):
    """A parameter in a parameter file; `node` is the name of its node or a pattern of names."""

    node: str
    key: str
    value: object


def read_parameter_file(path: Path) -> tuple[NodeParameter, ...]:
    """Return the parameters in the file, in the order of the file.

    Raises:
        ConfigError: The file cannot be read, or is not a ROS parameter file.
    """
    content = read_yaml(path)
    found = tuple(_sections(content, path, "")) if isinstance(content, dict) else ()
    if not found:
        raise ConfigError(
            f"{path}: not a ROS parameter file", f"write NODE: {{{_PARAMETERS}: {{KEY: VALUE}}}}"
        )
    return found


def _sections(content: Mapping[Any, Any], path: Path, node: str) -> Iterator[NodeParameter]:
    for name, inner in content.items():
        if name == _PARAMETERS and node and isinstance(inner, dict):
            yield from (NodeParameter(node, key, value) for key, value in flatten(inner))
        elif isinstance(inner, dict):
            yield from _sections(inner, path, f"{node.rstrip('/')}/{name}" if node else str(name))
        else:
            raise ConfigError(
                f"{path}: {name!r} stands outside of a node's {_PARAMETERS}",
                f"write NODE: {{{_PARAMETERS}: {{KEY: VALUE}}}}",
            )


def is_for(pattern: str, node: str) -> bool:
    """Return whether `pattern` matches the full node name `node`.

    `*` stands for one part of a name, `**` for any number of parts. A name without a slash and
    without `*` matches the node of this name in every namespace.
    """
    if "/" not in pattern and "*" not in pattern:
        return pattern == node.rpartition("/")[2]
    parts = pattern.strip("/").split("/")
    regex = "".join(
        "(/[^/]+)*" if part == "**" else "/[^/]+" if part == "*" else f"/{re.escape(part)}"
        for part in parts
    )
    return re.fullmatch(regex, node) is not None


def check_parameter_files(words: Sequence[str], node: str) -> None:
    """Check that each `--params-file` in the command line `words` has a parameter for `node`.

    Raises:
        ConfigError: A file cannot be read, or has parameters for other nodes only.
    """
    _, ros_words = ros_arguments.split(words)
    for option, value in pairwise(ros_words):
        if option != "--params-file":
            continue
        names = dict.fromkeys(each.node for each in read_parameter_file(Path(value)))
        if not any(is_for(name, node) for name in names):
            raise ConfigError(f"{value}: is for {', '.join(names)}, not for {node}", f"use {node}")


USE_SIM_TIME: Final = "use_sim_time"
"""The parameter that every ROS node has."""


@dataclass(frozen=True, slots=True)
class RosSettings:
    """The configuration after `--ros-args`, with the `remaps` that are left for rcl."""

    config: Config
    remaps: tuple[Remap, ...]
    use_sim_time: bool


def apply_arguments(
    config: Config,
    given: RosArguments,
    namespace: str,
    warn: Callable[[str], object] = log_warning,
) -> RosSettings:
    """Return the configuration changed by `--ros-args`, for nodes in `namespace`.

    `warn` is called with a sentence for each retired key, which is ignored.

    Raises:
        ConfigError: A key, a value or a file is wrong, or is meant for another node.
        UsageError: An argument names a node that the daemon does not have.
    """
    use_sim_time = False
    for key, value in _given_values(given, namespace).items():
        if key == USE_SIM_TIME:
            if not isinstance(value, bool):
                raise ConfigError(f"{key}: {value!r} is not allowed", "use true or false")
            use_sim_time = value
        elif not warn_of_retired(key, warn):
            config = with_setting(config, key, value)
    config, others = _with_topics(config, given.remaps, namespace)
    if given != NO_ARGUMENTS:
        check_together(config.kernel)
    return RosSettings(config, others, use_sim_time)


def _given_values(given: RosArguments, namespace: str) -> dict[str, object]:
    """Return the parameters from the arguments and their files, the later of two values."""
    for node in given.node_names:
        _check_node(node, f"{node}:__node" if node else "__node")
    names = {node: f"{namespace}/{given.node_names.get(node, node)}" for node in NODES}
    return dict(pair for setting in given.settings for pair in _settings(setting, names))


def _settings(setting: Assignment | Path, names: dict[str, str]) -> Iterator[tuple[str, object]]:
    """Yield each key and value of a `-p` or a file; `names` maps a node to its full name."""
    if isinstance(setting, Assignment):
        if setting.node:
            _check_node(setting.node, f"-p {setting.node}:{setting.key}")
            _check_owner(setting.node, setting.key)
        yield setting.key, read_value(f"-p {setting.key}", setting.text)
        return
    strangers: dict[str, None] = {}
    is_ours = False
    for node, key, value in read_parameter_file(setting):
        meant = [own for own, full in names.items() if is_for(node, full)]
        if not meant:
            strangers[node] = None
            continue
        is_ours = True
        if len(meant) == 1:
            try:
                _check_owner(meant[0], key)
            except ConfigError as error:
                raise ConfigError(f"{setting}: {error.cause}", error.cure) from None
        yield key, value
    if not is_ours:
        raise ConfigError(
            f"{setting}: is for {', '.join(strangers)}, not for a node of this daemon",
            f"use /**, or {', '.join(names.values())}",
        )


def _check_node(node: str, option: str) -> None:
    if node not in NODES:
        what = f"there is no node {node!r}" if node else f"the daemon has {len(NODES)} nodes"
        raise UsageError(f"--ros-args {option}: {what}", f"name one of {', '.join(NODES)}")


def _check_owner(node: str, key: str) -> None:
    if key != USE_SIM_TIME and key in flat(Config()) and node_of(key) != node:
        raise ConfigError(f"{key}: is no parameter of {node}", f"it is one of {node_of(key)}")


def _with_topics(
    config: Config, remaps: tuple[Remap, ...], namespace: str
) -> tuple[Config, tuple[Remap, ...]]:
    """Return the configuration with its topics remapped, and the remaps that are left for rcl."""

    def full(name: str) -> str:
        return name if name.startswith("/") else f"{namespace}/{name}"

    topics = {
        full(str(value)): key
        for (key, leaf), value in zip(keyed_leaves(config), flat(config).values(), strict=True)
        if leaf.declared.metadata.get("topic") and value
    }
    others: list[Remap] = []
    for rule in remaps:
        key = topics.get(full(rule.source))
        if rule.node:
            _check_node(rule.node, f"-r {rule.argument()}")
        if key is None or rule.node not in ("", node_of(key)):
            others.append(rule)
        else:
            config = with_setting(config, key, rule.target)
    return config, tuple(others)
