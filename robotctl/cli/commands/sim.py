"""sim: run only the simulated robot."""

from __future__ import annotations

import sys
from contextlib import ExitStack

from robotctl.cli.options import ConfigFile, DomainId, Robot, new_app
from robotctl.paths import DEFAULT_ROBOT, check_robot_name, namespace_of

app = new_app()


@app.command()
def sim(
    robot: Robot = DEFAULT_ROBOT,
    config: ConfigFile = None,
    domain_id: DomainId = None,
) -> None:
    """Run the simulated robot in a process of its own, until Ctrl-C.

    A daemon that is started afterwards finds it and drives it like a real robot. If that daemon
    dies, the simulated robot stops by its own command timeout.

    \b
    Examples:
      robotctl sim
      robotctl sim --robot r2 --domain-id 5
    """
    from robotctl import environment

    note = environment.prepare()
    if note:
        print(f"note: {note}", file=sys.stderr)
    import asyncio

    from robotctl.config import Config, load
    from robotctl.daemon.simulator import simulate
    from robotctl.domains import requested_domain

    domain = requested_domain(domain_id) or 0
    namespace = namespace_of(check_robot_name(robot))
    settings = Config() if config is None else load(config)

    def say_ready() -> None:
        print(f"simulated robot {robot} runs in ROS domain {domain} (Ctrl-C ends it)", flush=True)

    with ExitStack() as at_end:
        asyncio.run(
            simulate(
                settings, domain_id=domain, namespace=namespace, on_ready=say_ready, at_end=at_end
            )
        )
