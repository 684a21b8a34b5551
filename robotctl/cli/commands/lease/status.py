"""lease status: who holds the lease."""

from __future__ import annotations

from robotctl.cli.commands.lease.group import group
from robotctl.cli.options import Json, Robot
from robotctl.cli.support.answer import print_answer
from robotctl.cli.support.lease_token import own_token
from robotctl.cli.terminal.text import printable
from robotctl.ipc.answers import LeaseStatus
from robotctl.ipc.client import call
from robotctl.ipc.method_names import LEASE_STATUS
from robotctl.paths import DEFAULT_ROBOT


@group.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show who holds the lease.

    \b
    Examples:
      robotctl lease status --json
    """
    token = own_token()
    answer = call(robot, LEASE_STATUS, {"token": token} if token else {})
    print_answer(dict(answer), [_line(answer)], as_json=as_json)


def _line(answer: LeaseStatus) -> str:
    if answer["holder"] is None:
        return "the lease is free: any client may start a motion"
    why = f" ({answer['reason']})" if answer["reason"] else ""
    you = "; you act for it" if answer["yours"] else ""
    return f"{printable(answer['holder'])} holds the lease{printable(why)}{you}"
