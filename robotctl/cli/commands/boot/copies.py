"""boot sync: copy recordings to a store regularly, by a systemd timer beside the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.commands.boot.group import System, UnitUser, group, me
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.boot_unit import unit_path
from robotctl.cli.support.sync_unit import sync_units
from robotctl.cli.support.unit_files import (
    enable_unit,
    enabling_command,
    remove_unit,
    write_unit,
)
from robotctl.errors import Refused, UsageError
from robotctl.paths import DEFAULT_ROBOT, check_robot_name

copies = new_app()
group.add_typer(copies, name="sync")

Words = Annotated[
    list[str], typer.Argument(metavar="-- [FROM] TO [OPTION...]", help="What robotctl sync takes.")
]
Every = Annotated[
    int, typer.Option(min=1, metavar="MIN", help="Minutes from the end of a run to the next.")
]

_NOT_IN_A_UNIT = ("--robot", "--dry-run", "--json")
_PATHS = ("--recordings",)


@copies.callback()
def sync() -> None:
    """Copy recordings to a store regularly, by a systemd timer beside the daemon.

    \b
    Examples:
      robotctl boot sync show -- s3://bucket/robots/one --limit-mbps 20
      robotctl boot sync install -- s3://bucket/robots/one --pause-while-moving
      robotctl boot sync remove
    """


@copies.command()
def show(
    words: Words,
    every: Every = 10,
    system: System = False,
    user: UnitUser = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Print the service and the timer that `boot sync install` would write.

    \b
    Examples:
      robotctl boot sync show -- s3://bucket/robots/one --limit-mbps 20
    """
    made = sync_units(
        check_robot_name(robot),
        _sync_arguments(words),
        system=system,
        user=user or me(),
        every_min=every,
    )
    units = [{"path": str(each.path), "text": each.text} for each in made]
    lines = [f"# {each.path}\n{each.text}" for each in made]
    print_answer({"units": units}, ["\n".join(lines).rstrip("\n")], as_json=as_json)


@copies.command()
def install(
    words: Words,
    every: Every = 10,
    system: System = False,
    user: UnitUser = "",
    now: Annotated[bool, typer.Option("--now/--later", help="Start the timer at once.")] = True,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Write a service that runs `robotctl sync`, and its timer; enable the timer, and start it.

    The service runs at the lowest priority. Credentials, such as AWS_ACCESS_KEY_ID=..., belong
    into the file sync.env that the service names; make it readable for its user alone.

    \b
    Examples:
      robotctl boot sync install -- s3://bucket/robots/one --pause-while-moving
      sudo robotctl boot sync install --system --user ros -- s3://bucket/robots/one
    """
    timer, service = sync_units(
        check_robot_name(robot),
        _sync_arguments(words),
        system=system,
        user=user or me(),
        every_min=every,
    )
    write_unit(service)
    write_unit(timer)
    problem = enable_unit(timer, now=now)
    started = "" if problem else ", enabled and started" if now else ", enabled"
    lines = [f"{service.path} written", f"{timer.path} written{started}"]
    if problem:
        command = enabling_command(timer)
        lines.append(f"systemd did not take it ({problem}); once it runs: {command}")
    answer = {"paths": [str(service.path), str(timer.path)], "problem": problem}
    print_answer({**answer, "enabled": not problem}, lines, as_json=as_json)


@copies.command()
def remove(system: System = False, robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the timer, and remove it with its service; recordings and copies stay.

    \b
    Examples:
      robotctl boot sync remove
    """
    service = unit_path(f"{check_robot_name(robot)}-sync", system=system)
    paths = [each for each in (service.with_suffix(".timer"), service) if each.exists()]
    if not paths:
        raise Refused(f"there is no {service}", "robotctl boot sync install writes one")
    problems = [remove_unit(path, system=system) for path in paths]
    problem = next(filter(None, problems), "")
    lines = [f"{path} removed" for path in paths] + ([f"systemd: {problem}"] if problem else [])
    answer = {"paths": [str(path) for path in paths], "problem": problem}
    print_answer(answer, lines, as_json=as_json)


def _sync_arguments(words: list[str]) -> tuple[str, ...]:
    """Return what `robotctl sync` takes, with absolute paths: a unit has another working folder.

    Raises:
        UsageError: It would not take them, or they do not belong into a unit.
    """
    from robotctl.cli.commands.sync import app
    from robotctl.store import is_url

    for word in words:
        if word.partition("=")[0] in _NOT_IN_A_UNIT:
            raise UsageError(f"{word} in a unit", "leave it out")
    taken = typer.main.get_command(app).make_context("robotctl sync", list(words)).params
    places = taken["places"]
    absolute = [str(Path(w).absolute()) if w in places and not is_url(w) else w for w in words]
    before = ("", *words)
    return tuple(
        str(Path(word).absolute()) if previous in _PATHS else word
        for previous, word in zip(before, absolute, strict=False)
    )
