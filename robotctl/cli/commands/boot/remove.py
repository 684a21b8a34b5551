"""boot remove: stop the unit, and delete it."""

from __future__ import annotations

from robotctl.cli.commands.boot.group import System, group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.boot_unit import unit_path
from robotctl.cli.support.unit_files import remove_unit
from robotctl.errors import Refused
from robotctl.paths import DEFAULT_ROBOT, check_robot_name


@group.command()
def remove(system: System = False, robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the daemon that systemd started, and delete its unit; recordings stay.

    \b
    Examples:
      robotctl boot remove
    """
    path = unit_path(check_robot_name(robot), system=system)
    if not path.exists():
        raise Refused(f"there is no {path}", "robotctl boot install writes one")
    problem = remove_unit(path, system=system)
    lines = [f"{path} removed" + (f"; systemd: {problem}" if problem else ", the daemon stopped")]
    print_answer({"path": str(path), "problem": problem}, lines, as_json=as_json)
