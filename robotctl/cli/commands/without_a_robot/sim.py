"""sim: the simulated robot, alone or as it fails."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT, check_namespace, check_robot_name, namespace_of
from robotctl.cli.options import ConfigFile, DomainId, Json, Namespace, Robot, new_app
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.ipc.client import call
from robotctl.ipc.method_names import SIM_FAULT, SIM_SET
from robotctl.sim.robot import MAX_FAULT_S, SimFault

app = new_app()
group = new_app()
app.add_typer(group, name="sim")


@group.callback(invoke_without_command=True)
def sim(
    context: typer.Context,
    robot: Robot = DEFAULT_ROBOT,
    namespace: Namespace = None,
    config: ConfigFile = None,
    domain_id: DomainId = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="End at once where odometry is published already.")
    ] = False,
) -> None:
    """Run the simulated robot in a process of its own, until Ctrl-C.

    A daemon that is started afterwards finds it and drives it like a real robot. If that daemon
    dies, the simulated robot stops by its own command timeout. `set` and `fault` act on the robot
    that a daemon simulates itself (robotctl start --sim).

    \b
    Examples:
      robotctl sim
      robotctl sim --robot r2 --domain-id 5
      robotctl sim fault odom-lost --for 2s
    """
    if context.invoked_subcommand is not None:
        return
    from robotctl.base import environment

    note = environment.prepare()
    if note:
        print(f"note: {note}", file=sys.stderr)
    import asyncio

    from robotctl.base.domains import requested_domain
    from robotctl.config import Config, load
    from robotctl.daemon.simulator import simulate

    domain = requested_domain(domain_id) or 0
    name = check_robot_name(robot)
    full = namespace_of(name) if namespace is None else check_namespace(namespace)
    settings = Config() if config is None else load(config)

    def say_ready() -> None:
        print(f"simulated robot {robot} runs in ROS domain {domain} (Ctrl-C ends it)", flush=True)

    with ExitStack() as at_end:
        asyncio.run(
            simulate(
                settings,
                domain_id=domain,
                namespace=full,
                on_ready=say_ready,
                at_end=at_end,
                only_if_missing=auto,
            )
        )


KEY = "battery"


@group.command("set")
def change(
    setting: Annotated[str, typer.Argument(metavar="battery=LEVEL", help="0 to 1.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Set the battery level of the robot that the daemon simulates.

    \b
    Examples:
      robotctl sim set battery=0.1
    """
    answer = call(robot, SIM_SET, {KEY: _level(setting), "source": request_source("sim set")})
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def _level(setting: str) -> float:
    key, _, text = setting.partition("=")
    try:
        level = float(text) if key == KEY else -1.0
    except ValueError:
        level = -1.0
    if not 0.0 <= level <= 1.0:
        raise UsageError(f"{printable(setting)}", "use battery=0 to battery=1")
    return level


_NAMES = ", ".join(fault.value for fault in SimFault)
_UNITS = (("ms", 1e-3), ("s", 1.0), ("", 1.0))


@group.command("fault")
def fail(
    fault: Annotated[SimFault, typer.Argument(metavar="FAULT", help=f"One of {_NAMES}.")],
    duration: Annotated[
        str, typer.Option("--for", metavar="TIME", help="How long, such as 2s or 500ms.")
    ] = "2s",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Let the robot that the daemon simulates fail for a while, and tell when it stopped.

    The milliseconds go from the fault to the mode that commands zero.

    \b
    Examples:
      robotctl sim fault odom-lost --for 2s
      robotctl sim fault slip --for 5s
    """
    params = {
        "fault": fault.value,
        "for_s": seconds(duration),
        "source": request_source("sim fault"),
    }
    answer = call(robot, SIM_FAULT, params, deadline_s=None)
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def seconds(text: str) -> float:
    """Return the seconds of a duration such as `2s` or `500ms`.

    Raises:
        UsageError: The text is no duration, or the duration is not above 0 or too long.
    """
    unit, factor = next((unit, factor) for unit, factor in _UNITS if text.endswith(unit))
    try:
        found = float(text.removesuffix(unit)) * factor
    except ValueError:
        found = math.nan
    if not 0.0 < found <= MAX_FAULT_S:
        raise UsageError(f"--for {printable(text)}", f"use 1ms to {MAX_FAULT_S:g}s")
    return found
