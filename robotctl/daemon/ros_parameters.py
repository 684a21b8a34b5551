"""The parameters on ROS: which node has which key, and a change by a service of a node."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.config import declarations, flat
from robotctl.config.ros_settings import MODE_SERVICE, SIMULATED_ROBOT, node_of
from robotctl.daemon.parameters import Parameters, Setting
from robotctl.ipc.advice import advice
from robotctl.kernel.ranges import Change
from robotctl.ros.nodes.node_services import Declared, ParameterServices
from robotctl.ros.session import Session


def serve_parameters(session: Session, parameters: Parameters, robot: str) -> None:
    """Give each visible node its parameters and their services; cures in errors name `robot`."""

    def ask(settings: Sequence[tuple[str, Any]], source: str) -> str:
        try:
            reply = parameters.request([Setting(*each) for each in settings], source)
        except RobotctlError as error:
            return str(error)
        return "" if reply.ok else advice(reply.message, reply.remedies, robot).sentence

    values = flat(parameters.config)
    for name, node in session.visible_nodes.items():
        declared = [
            Declared(
                each.key,
                values[each.key],
                each.about,
                f"{each.allowed}; changes {each.change.value}",
                each.range,
                read_only=each.change is Change.START,
            )
            for each in declarations().values()
            if _served_by(each.key, session.visible_nodes) == name
        ]
        parameters.followers.append(ParameterServices(node, declared, ask).show)


def _served_by(key: str, nodes: Container[str]) -> str:
    """Return the node that declares a key: `mode_service`, where its usual node is not here.

    The simulated robot's keys are left out where none is simulated.
    """
    node = node_of(key)
    return node if node in nodes or node == SIMULATED_ROBOT else MODE_SERVICE
