"""The group `sim`: without a command, it runs only the simulated robot."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Annotated

import typer

from robotctl.cli.options import ConfigFile, DomainId, Namespace, Robot, new_app
from robotctl.paths import DEFAULT_ROBOT, check_namespace, check_robot_name, namespace_of

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
    from robotctl import environment

    note = environment.prepare()
    if note:
        print(f"note: {note}", file=sys.stderr)
    import asyncio

    from robotctl.config import Config, load
    from robotctl.daemon.simulator import simulate
    from robotctl.domains import requested_domain

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
