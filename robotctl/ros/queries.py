"""`python -m robotctl.ros.queries --report-fd N`: answer one query about ROS, for a command.

The query is a JSON object on the first line of stdin: `look` (`names`, `topic`, `node`, `listen` or
`call`), `domain_id` and the arguments. Each answer is a report to descriptor N. A failure has
{"error", "exit_code"} and details. The process ends when its parent closes stdin.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from robotctl.base import environment
from robotctl.base.errors import RobotctlError, UsageError
from robotctl.base.processes import report_fd, send_report

if TYPE_CHECKING:
    from robotctl.ros.context import Membership
    from robotctl.ros.exchange import Send


def main(arguments: list[str]) -> int:
    """Answer one query, or report its failure. Return 0 in both cases."""
    environment.prepare()
    send = partial(send_report, report_fd(arguments))
    with suppress(BrokenPipeError, asyncio.CancelledError):  # nothing waits for the answer any more
        try:
            # This imports rclpy: after environment.prepare(), but before the wait for the line.
            from robotctl.ros.context import Membership
            from robotctl.ros.graph.endpoints import LOOK_NODE

            line = _first_line()
            if not line:
                return 0
            request = json.loads(line)
            with Membership(request["domain_id"], f"{LOOK_NODE}{os.getpid()}") as visitor:
                _look(visitor, request, send)
        except RobotctlError as error:
            send({"error": str(error), "exit_code": error.exit_code, **error.details()})
        except Exception as error:  # noqa: BLE001 - the command shows it
            text = f"unexpected {type(error).__name__}: {error}"
            send({"error": text, "exit_code": RobotctlError.exit_code})
    return 0


def _look(visitor: Membership, request: dict[str, Any], send: Send) -> None:
    """Run the query in the domain, and `send` its answers.

    Raises:
        RobotctlError: The query is refused.
    """
    # Discovery goes on during these imports.
    if request["look"] in ("listen", "call"):  # these import numpy, which takes 60 ms
        from robotctl.ros import exchange

        exchange.run(getattr(exchange, request["look"])(visitor, request, send))
        return
    from robotctl.ros.graph.endpoints import node_facts, overview, topic_facts

    visitor.discover(lambda: False)  # wait until every process is discovered
    match request["look"]:
        case "names":
            send(overview(visitor.node))
        case "topic":
            send(topic_facts(visitor.node, request["name"]))
        case "node":
            found = node_facts(visitor.node, request["name"])
            if found is None:
                raise UsageError(f"no node {request['name']!r}")
            send(found)


def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n") and (piece := os.read(0, 1 << 16)):
        line += piece
    return line


if __name__ == "__main__":
    code = main(sys.argv[1:])
    os._exit(code)  # the domain is left already; a destructor of Fast DDS sleeps for 0.1 s
