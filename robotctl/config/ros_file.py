"""Read a ROS parameter file, which may hold the parameters of several nodes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from robotctl import ros_arguments
from robotctl.config.file import flatten, read_yaml
from robotctl.errors import ConfigError

_PARAMETERS = "ros__parameters"


class NodeParameter(NamedTuple):
    """One value in a file, and the name or pattern of the nodes that it is for."""

    node: str
    key: str
    value: object


def read_parameter_file(path: Path) -> tuple[NodeParameter, ...]:
    """Return the parameters in the file, in its order.

    Raises:
        ConfigError: The file cannot be read, or is no ROS parameter file.
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
            yield from (NodeParameter(node, key, value) for key, value in flatten(inner, path))
        elif isinstance(inner, dict):
            yield from _sections(inner, path, f"{node.rstrip('/')}/{name}" if node else str(name))
        else:
            raise ConfigError(
                f"{path}: {name!r} stands outside of a node's {_PARAMETERS}",
                f"write NODE: {{{_PARAMETERS}: {{KEY: VALUE}}}}",
            )


def is_for(pattern: str, node: str) -> bool:
    """Return whether a name or pattern of a file means the node with this full name.

    `*` stands for one part of a name and `**` for any number of parts; a name without a slash means
    the node in every namespace.
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
    """Check that each `--params-file` of a command line has something for the node.

    Raises:
        ConfigError: A file cannot be read, or is for other nodes only.
    """
    _, ros_words = ros_arguments.split(words)
    for option, value in pairwise(ros_words):
        if option != "--params-file":
            continue
        names = dict.fromkeys(each.node for each in read_parameter_file(Path(value)))
        if not any(is_for(name, node) for name in names):
            raise ConfigError(f"{value}: is for {', '.join(names)}, not for {node}", f"use {node}")
