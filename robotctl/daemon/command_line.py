"""The daemon's command line."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from robotctl.config import PATTERN_HELP, Config, is_topic_pattern
from robotctl.domains import requested_domain
from robotctl.errors import UsageError
from robotctl.kernel.patterns import PatternKind
from robotctl.paths import DEFAULT_ROBOT, check_robot_name, namespace_of


@dataclass(frozen=True, slots=True)
class DaemonOptions:
    """The options of a start; `sim` None: simulate unless odometry has a publisher already."""

    robot: str
    config: Path | None
    recordings: Path
    drive: PatternKind | None
    sim: bool | None
    domain_id: int
    observe: bool = False
    """Record only."""

    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    """Patterns of topics, added to those of the configuration."""

    @property
    def namespace(self) -> str:
        """The robot's ROS namespace."""
        return namespace_of(self.robot)

    def applied_to(self, config: Config) -> Config:
        """Return the configuration with the topic patterns of the command line added."""
        given = config.recording
        include, exclude = (*given.include, *self.include), (*given.exclude, *self.exclude)
        return replace(config, recording=replace(given, include=include, exclude=exclude))


def parse(arguments: list[str]) -> DaemonOptions:
    """Return the options.

    Raises:
        UsageError: A name or number is not allowed.
    """
    parser = argparse.ArgumentParser(prog="python -m robotctl.daemon", description=__doc__)
    parser.add_argument("--robot", default=DEFAULT_ROBOT)
    parser.add_argument("--config", type=Path)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--drive", choices=[kind.value for kind in PatternKind])
    parser.add_argument("--sim", action=argparse.BooleanOptionalAction)
    parser.add_argument("--domain-id", type=int)
    parser.add_argument("--observe", action="store_true")
    parser.add_argument("--include", action="append", default=[])
    parser.add_argument("--exclude", action="append", default=[])
    parser.add_argument("--ready-fd", type=int)
    given = parser.parse_args(arguments)
    if given.observe and (given.drive or given.sim):
        raise UsageError(
            "--observe records and does nothing else", "leave out --drive and --sim, or --observe"
        )
    return DaemonOptions(
        robot=check_robot_name(given.robot),
        config=given.config,
        recordings=_absolute(given.recordings),
        drive=None if given.drive is None else PatternKind(given.drive),
        sim=given.sim,
        domain_id=requested_domain(given.domain_id) or 0,
        observe=given.observe,
        include=_patterns("--include", given.include),
        exclude=_patterns("--exclude", given.exclude),
    )


def _absolute(recordings: Path) -> Path:
    try:
        return recordings.absolute()
    except FileNotFoundError:
        cure = "cd to a folder that exists, or give --recordings a path from the root"
        raise UsageError("the working folder was removed", cure) from None


def _patterns(option: str, given: list[str]) -> tuple[str, ...]:
    """Return the patterns of a repeatable option; each use may hold several, with commas."""
    patterns = [pattern for text in given for pattern in text.split(",")]
    for pattern in patterns:
        if not is_topic_pattern(pattern):
            raise UsageError(f"{option}: {pattern!r} is not allowed", f"use {PATTERN_HELP}")
    return tuple(patterns)


def parse_ready_fd(arguments: list[str]) -> int | None:
    """Return the descriptor for the report of the start, even if other options are wrong."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--ready-fd", type=int)
    descriptor: int | None = parser.parse_known_args(arguments)[0].ready_fd
    return descriptor
