"""boot show: the unit, without installing it."""

from __future__ import annotations

from robotctl.cli.commands.boot.group import Arguments, System, UnitUser, group, me, start_arguments
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.boot_unit import unit
from robotctl.paths import DEFAULT_ROBOT, check_robot_name


@group.command()
def show(
    arguments: Arguments = None,
    system: System = False,
    user: UnitUser = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Print the unit that `boot install` would write, for packages and containers.

    \b
    Examples:
      robotctl boot show -- --no-sim > robotctl.service
    """
    made = unit(
        check_robot_name(robot), start_arguments(arguments), system=system, user=user or me()
    )
    print_answer(
        {"path": str(made.path), "text": made.text}, [made.text.rstrip("\n")], as_json=as_json
    )
