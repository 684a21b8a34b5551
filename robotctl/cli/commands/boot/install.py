"""boot install: write the unit, and start it."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.cli.commands.boot.group import Arguments, System, UnitUser, group, me, start_arguments
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.boot_unit import unit
from robotctl.cli.support.unit_files import enable_unit, enabling_command, write_unit
from robotctl.paths import DEFAULT_ROBOT, RUNTIME_VARIABLE, check_robot_name


@group.command()
def install(
    arguments: Arguments = None,
    system: System = False,
    user: UnitUser = "",
    now: Annotated[bool, typer.Option("--now/--later", help="Start it at once.")] = True,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Write the systemd unit of the daemon, enable it, and start it.

    A daemon that fails is started again, and the robot does not move by that. For a unit of yours
    to run while you are not logged in: loginctl enable-linger.

    \b
    Examples:
      robotctl boot install -- --no-sim --config robot.yaml
      sudo robotctl boot install --system --user ros -- --no-sim
    """
    runner = user or me()
    made = unit(check_robot_name(robot), start_arguments(arguments), system=system, user=runner)
    write_unit(made)
    problem = enable_unit(made, now=now)
    started = "" if problem else "enabled and started" if now else "enabled"
    lines = [f"{made.path} written" + (f", {started}" if started else "")]
    if problem:
        lines.append(f"systemd did not take it ({problem}); once it runs: {enabling_command(made)}")
    if made.runtime:
        variable = f"export {RUNTIME_VARIABLE}={made.runtime}"
        lines.append(
            f"commands of {runner}, and of members of socket.group, reach it by: {variable}"
        )
    answer = {"path": str(made.path), "enabled": not problem, "problem": problem}
    print_answer(answer, lines, as_json=as_json)
