"""doctor: what is wrong with this computer or its ROS graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer

from robotctl.base.errors import Refused
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import ConfigFile, DomainId, Json, Robot, new_app
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.doctor.machine import Finding, Level

app = new_app()


@app.command()
def doctor(
    clean: Annotated[
        bool, typer.Option("--clean", help="Remove what killed processes of you left.")
    ] = False,
    robot: Robot = DEFAULT_ROBOT,
    config: ConfigFile = None,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Find what is wrong here: installation, discovery, ROS graph, machine.

    It looks at the shell, command and odometry on ROS, shared memory, disk, clock and permissions.
    Exit code 0 if there is no fault (warnings are none), else 4.

    \b
    Examples:
      robotctl doctor
      robotctl doctor --clean
      robotctl doctor --json
    """
    from robotctl.cli.commands.without_a_robot.doctor.diagnosis import diagnose

    removed, found = diagnose(robot, config, domain_id, clean=clean)
    faults = [each for each in found if each.level is Level.FAULT]
    answer = {"findings": [each.as_object() for each in found], "removed": removed}
    error = None
    if faults:
        count = f"{len(faults)} fault{'s' if len(faults) > 1 else ''}"
        error = Refused(f"{count}, the first: {faults[0].text}", faults[0].cure)
    print_answer(answer, _lines(removed, found), as_json=as_json, error=error)


def _lines(removed: list[str], found: list[Finding]) -> Iterator[str]:
    """Yield a line for each finding, and a second line if it has a cure."""
    width = max((len(each.check) for each in found), default=0)
    order = {Level.OK: 0, Level.WARNING: 1, Level.FAULT: 2}
    if removed:
        yield f"removed {len(removed)} files of dead processes"
    for each in sorted(found, key=lambda each: order[each.level]):
        yield f"{each.level.value:8} {each.check:{width}}  {printable(each.text)}"
        if each.cure:
            yield f"{'':8} {'':{width}}  cure: {printable(each.cure)}"
