"""The methods of the control socket that tell what the daemon sees on ROS."""

from __future__ import annotations

from typing import Any, cast

from robotctl.errors import UsageError
from robotctl.ipc.graph_answers import Graph, GraphNode, GraphTopic
from robotctl.ipc.method import Method
from robotctl.ipc.method_names import GRAPH, GRAPH_NODE, GRAPH_TOPIC
from robotctl.ipc.params import GraphNameParams, NoParams
from robotctl.ros.graph.overview import node_facts, overview, topic_facts
from robotctl.ros.tap.tap import Tap


def graph_methods(tap: Tap) -> dict[str, Method[Any]]:
    """Return `graph`, `graph_topic` and `graph_node`; what they tell, rcl has at hand."""

    async def graph(_: NoParams) -> Graph:
        return cast(Graph, overview(tap.node))

    async def topic(params: GraphNameParams) -> GraphTopic:
        return cast(GraphTopic, topic_facts(tap.node, params.name))

    async def node(params: GraphNameParams) -> GraphNode:
        found = node_facts(tap.node, params.name)
        if found is None:
            raise UsageError(f"no node {params.name!r}")
        return cast(GraphNode, found)

    return {
        GRAPH: Method(NoParams, graph),
        GRAPH_TOPIC: Method(GraphNameParams, topic),
        GRAPH_NODE: Method(GraphNameParams, node),
    }
