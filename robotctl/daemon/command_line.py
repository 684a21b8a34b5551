"""The daemon's command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from robotctl.base import ros_arguments
from robotctl.base.domains import requested_domain
from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT, check_namespace, check_robot_name, namespace_of
from robotctl.base.ros_arguments import NO_ARGUMENTS, LogLevel, RosArguments, read_log_level
from robotctl.config import PATTERN_HELP, Config, is_topic_pattern
from robotctl.config.ros_settings import RosSettings, apply_arguments
from robotctl.kernel.patterns import PatternKind


@dataclass(frozen=True, slots=True)
class DaemonOptions:
    """A daemon's options. With `sim` None, it simulates a robot unless odometry has a publisher."""

    robot: str
    config: Path | None
    recordings: Path
    drive: PatternKind | None
    sim: bool | None
    domain_id: int
    observe: bool = False
    """Record only: do not drive or simulate a robot."""

    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    """`include` and `exclude` are topic patterns, added to those of the configuration."""

    ros_namespace: str | None = None
    """The value of `--namespace`, None if not given."""

    allow_same_names: bool = False
    """Start although another daemon runs whose nodes have the same names."""

    log_level: tuple[LogLevel, ...] = ()
    """The levels of `--log-level`; levels in `--ros-args` override these."""

    ros: RosArguments = NO_ARGUMENTS
    """The arguments of `--ros-args`."""

    @property
    def namespace(self) -> str:
        """The robot's ROS namespace, "" for none."""
        for given in (self.ros_namespace, self.ros.namespace):
            if given is not None:
                return given
        return namespace_of(self.robot)

    def applied_to(self, config: Config, warn: Callable[[str], object]) -> RosSettings:
        """Return the settings that `config`, `--ros-args` and the topic patterns give together.

        `warn` is called with a sentence for each retired key of the configuration.

        Raises:
            ConfigError: A parameter, a value or a parameter file is wrong.
        """
        settings = apply_arguments(config, self.ros, self.namespace, warn)
        config = settings.config
        given = config.recording
        include, exclude = (*given.include, *self.include), (*given.exclude, *self.exclude)
        config = replace(config, recording=replace(given, include=include, exclude=exclude))
        return replace(settings, config=config)


def parse(arguments: list[str]) -> DaemonOptions:
    """Return the options in the words of a command line.

    Raises:
        UsageError: A name or number is not allowed.
    """
    parser = argparse.ArgumentParser(prog="python -m robotctl.daemon", description=__doc__)
    parser.add_argument("--robot", default=DEFAULT_ROBOT)
    parser.add_argument("--namespace")
    parser.add_argument("--config", type=Path)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--drive", choices=[kind.value for kind in PatternKind])
    parser.add_argument("--sim", action=argparse.BooleanOptionalAction)
    parser.add_argument("--domain-id", type=int)
    parser.add_argument("--observe", action="store_true")
    parser.add_argument("--include", action="append", default=[])
    parser.add_argument("--exclude", action="append", default=[])
    parser.add_argument("--allow-same-names", action="store_true")
    parser.add_argument("--log-level", action="append", default=[])
    parser.add_argument("--ready-fd", type=int)
    arguments, ros_words = ros_arguments.split(arguments)
    given = parser.parse_args(arguments)
    if given.observe and (given.drive or given.sim):
        raise UsageError(
            "--observe records and does nothing else", "leave out --drive and --sim, or --observe"
        )
    return DaemonOptions(
        robot=check_robot_name(given.robot),
        config=given.config,
        recordings=absolute(given.recordings),
        drive=None if given.drive is None else PatternKind(given.drive),
        sim=given.sim,
        domain_id=requested_domain(given.domain_id) or 0,
        observe=given.observe,
        ros_namespace=None if given.namespace is None else check_namespace(given.namespace),
        include=_patterns("--include", given.include),
        exclude=_patterns("--exclude", given.exclude),
        allow_same_names=given.allow_same_names,
        log_level=tuple(map(read_log_level, given.log_level)),
        ros=ros_arguments.parse(ros_words),
    )


def absolute(recordings: Path) -> Path:
    """Return `recordings` as an absolute path.

    Raises:
        UsageError: The path is relative, and the working folder was removed.
    """
    try:
        return recordings.absolute()
    except FileNotFoundError:
        cure = "cd to a folder that exists, or give --recordings a path from the root"
        raise UsageError("the working folder was removed", cure) from None


def _patterns(option: str, given: list[str]) -> tuple[str, ...]:
    """Return the comma-separated patterns of all uses of an option, or raise UsageError."""
    patterns = [pattern for text in given for pattern in text.split(",")]
    for pattern in patterns:
        if not is_topic_pattern(pattern):
            raise UsageError(f"{option}: {pattern!r} is not allowed", f"use {PATTERN_HELP}")
    return tuple(patterns)


def parse_ready_fd(arguments: list[str]) -> int | None:
    """Return the value of `--ready-fd` or None, without errors about other options."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--ready-fd", type=int)
    others, _ = ros_arguments.split(arguments)
    descriptor: int | None = parser.parse_known_args(others)[0].ready_fd
    return descriptor
