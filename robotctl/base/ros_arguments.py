"""`--ros-args` of a command line: parameters, parameter files, remaps, names, log levels.

The syntax is that of rcl (https://design.ros2.org/articles/ros_command_line_arguments.html).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.base.errors import UsageError

LEVELS: Final = {"DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40, "FATAL": 50}
"""The numbers of rcl_interfaces/msg/Log and of `logging`."""

UNSET: Final = 0
"""The level of a logger that inherits the level of its parent."""


@dataclass(frozen=True, slots=True)
class LogLevel:
    """The level of `logger`, or, for "", of all loggers without a level of their own."""

    logger: str
    level: int


def read_log_level(text: str) -> LogLevel:
    """Parse the value LEVEL or LOGGER:=LEVEL of `--log-level`.

    Raises:
        UsageError: The text has another form, or there is no such level.
    """
    logger, sign, name = text.rpartition(":=")
    level = LEVELS.get(name.upper())
    if level is None or (sign and not logger.strip()):
        names = ", ".join(LEVELS).lower()
        raise UsageError(f"--log-level {text!r} is not allowed", f"use {names}, or LOGGER:=LEVEL")
    return LogLevel(logger.strip(), level)


def level_name(level: int) -> str:
    """Return the name of the highest ROS level up to `level`, "UNSET" if there is none."""
    return max((each, name) for name, each in {"UNSET": UNSET, **LEVELS}.items() if each <= level)[
        1
    ]


BEGIN, END = "--ros-args", "--"
LOG_LEVEL = "--log-level"

_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*/?")
_NAME = re.compile(r"~?/?[A-Za-z_~][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

_TAKEN = (
    "use -p KEY:=VALUE, -r FROM:=TO, -r __ns:=/NAMESPACE, -r NODE:__node:=NAME, "
    "--params-file FILE, --log-level LEVEL"
)


@dataclass(frozen=True, slots=True)
class Assignment:
    """A parameter from `-p [NODE:]KEY:=VALUE`; `node` "" is every node, `text` is YAML."""

    node: str
    key: str
    text: str


@dataclass(frozen=True, slots=True)
class Remap:
    """A remapping rule from `-r [NODE:]FROM:=TO`; `node` "" is every node."""

    node: str
    source: str
    target: str

    def argument(self) -> str:
        """Return the rule as a command-line argument, without `-r`."""
        return (
            f"{self.node}:{self.source}:={self.target}"
            if self.node
            else (f"{self.source}:={self.target}")
        )


@dataclass(frozen=True, slots=True)
class RosArguments:
    """The parsed arguments in their order; `namespace` is None if no argument sets it.

    Later items of `settings` and `log_levels` override earlier ones. `node_names` maps a node's
    usual name, "" for every node, to its new name.
    """

    settings: tuple[Assignment | Path, ...] = ()
    remaps: tuple[Remap, ...] = ()
    namespace: str | None = None
    node_names: dict[str, str] = field(default_factory=dict)
    log_levels: tuple[LogLevel, ...] = ()


NO_ARGUMENTS = RosArguments()


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a command line without `--ros-args` sections, and the words in those sections."""
    others: list[str] = []
    ros: list[str] = []
    inside = False
    for word in arguments:
        if not inside and word == BEGIN:
            inside = True
        elif inside and word == END:
            inside = False
        elif word != BEGIN:
            (ros if inside else others).append(word)
    return others, ros


def with_log_levels(arguments: Sequence[str]) -> list[str]:
    """Return a command line with each `--log-level LEVEL` moved to a `--ros-args` section, for rcl.

    Raises:
        UsageError: A level is not allowed.
    """
    others: list[str] = []
    levels: list[str] = []
    words = iter(arguments)
    for word in words:
        name, sign, value = word.partition("=")
        if word == BEGIN:
            others += [word, *words]
        elif name == LOG_LEVEL:
            level = value if sign else next(words, "")
            read_log_level(level)
            levels += [LOG_LEVEL, level]
        else:
            others.append(word)
    return [*others, BEGIN, *levels] if levels else others


def parse(words: Sequence[str]) -> RosArguments:
    """Parse the words in the `--ros-args` sections.

    Raises:
        UsageError: An argument is unknown or wrong.
    """
    settings: list[Assignment | Path] = []
    remaps: list[Remap] = []
    namespace: str | None = None
    names: dict[str, str] = {}
    levels: list[LogLevel] = []
    for option, value in _options(words):
        if option == LOG_LEVEL:
            levels.append(read_log_level(value))
            continue
        if option == "--params-file":
            settings.append(Path(value))
            continue
        node, left, right = _rule(option, value)
        if option == "-p":
            settings.append(Assignment(node, left, right))
        elif left == "__ns":
            if node:
                raise UsageError(f"-r {value}", "all nodes share one namespace: -r __ns:=/NAME")
            namespace = _namespace(right)
        elif left == "__node":
            if not _NODE.fullmatch(right):
                raise _wrong(option, value, "a node's name has letters, digits and underscores")
            names[node] = right
        else:
            remaps.append(Remap(node, *(_checked_name(value, each) for each in (left, right))))
    return RosArguments(tuple(settings), tuple(remaps), namespace, names, tuple(levels))


def _options(words: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each option in its short form, with its value."""
    rest = iter(words)
    for word in rest:
        option = {"--param": "-p", "--remap": "-r"}.get(word, word)
        if option not in ("-p", "-r", "--params-file", LOG_LEVEL):
            raise UsageError(f"--ros-args {word!r} is not supported", _TAKEN)
        value = next(rest, None)
        if value is None:
            raise UsageError(f"--ros-args {word}: the value is missing", _TAKEN)
        yield option, value


def _rule(option: str, value: str) -> tuple[str, str, str]:
    """Split `[NODE:]LEFT:=RIGHT` into (NODE or "", LEFT, RIGHT)."""
    left, sign, right = value.partition(":=")
    node, colon, name = left.rpartition(":")
    if not sign or not name or (colon and not _NODE.fullmatch(node)):
        raise _wrong(option, value, _TAKEN)
    return node, name, right


def _namespace(text: str) -> str:
    """Return a namespace in the form /NAME, or "" for the root."""
    full = text if text.startswith("/") else f"/{text}"
    if not _NAMESPACE.fullmatch(full) or "__" in full:
        raise _wrong(
            "-r", f"__ns:={text}", "a namespace is /NAME, of letters, digits and underscores"
        )
    return full.rstrip("/")


def _checked_name(rule: str, name: str) -> str:
    bare = re.sub(r"^(rostopic|rosservice)://", "", name)
    if not _NAME.fullmatch(bare) and not re.fullmatch(rf"/{_NAME.pattern}", bare):
        raise _wrong("-r", rule, "a name is /a/b or a/b, of letters, digits and underscores")
    return bare


def _wrong(option: str, value: str, allowed: str) -> UsageError:
    return UsageError(f"{option} {value!r} is not allowed", allowed)
