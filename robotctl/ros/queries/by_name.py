"""The looks by their names."""

from __future__ import annotations

from typing import Any

from robotctl.errors import UsageError
from robotctl.ros.graph.overview import node_facts, overview, topic_facts
from robotctl.ros.queries.visitor import Send, Visitor


def look(request: dict[str, Any], send: Send) -> None:
    """Join the domain, look, and leave it.

    Raises:
        RobotctlError: The look is refused; the text says why.
    """
    with Visitor(request["domain_id"]) as visitor:
        match request["look"]:
            case "names":
                visitor.settle()
                send(overview(visitor.node))
            case "topic":
                visitor.settle()
                send(topic_facts(visitor.node, request["name"]))
            case "node":
                visitor.settle()
                found = node_facts(visitor.node, request["name"])
                if found is None:
                    raise UsageError(f"no node {request['name']!r}")
                send(found)
            case "listen":
                from robotctl.ros.queries.listen import listen

                visitor.run(listen(visitor, request, send))
            case "call":
                from robotctl.ros.queries.call import call

                visitor.run(call(visitor, request, send))
