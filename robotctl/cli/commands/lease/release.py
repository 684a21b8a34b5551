"""lease release: give the lease back."""

from __future__ import annotations

from robotctl.cli.commands.lease.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.lease_token import own_token
from robotctl.cli.support.quick_actions import request_source
from robotctl.cli.terminal.text import printable
from robotctl.ipc.client import call
from robotctl.ipc.method_names import LEASE_RELEASE
from robotctl.paths import DEFAULT_ROBOT


@group.command()
def release(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Release the lease of this shell; a robot that moves ramps down.

    It works where ROBOTCTL_LEASE holds the token, as in the command that `lease take` runs.

    \b
    Examples:
      robotctl lease release
    """
    token = own_token()
    params = {"source": request_source("lease release")} | ({"token": token} if token else {})
    answer = call(robot, LEASE_RELEASE, params)
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)
