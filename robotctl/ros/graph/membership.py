"""A node in a ROS domain, from which a command discovers the other processes."""

from __future__ import annotations

import time
from typing import Self

from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.base.domains import is_certainly_empty
from robotctl.ros.context import close_context, open_context


class Membership:
    """A node in a ROS domain; at the end of the `with` block it leaves the domain.

    The module imports little, so that discovery, in the middleware's threads, begins early and
    goes on while the command imports the rest.
    """

    def __init__(self, domain_id: int, node_name: str) -> None:
        self.domain_id = domain_id
        self.was_certainly_empty = is_certainly_empty(domain_id)
        """Whether the domain surely had no other process when this process joined it."""

        self.since_s = time.monotonic()
        self._context = open_context(domain_id)
        self.node = Node(
            node_name,
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        # Imported only here: the middleware discovers other processes during the import.
        from robotctl.ros.graph.discovery import Discovery

        self.discovery = Discovery(self.node, domain_id)

    def __enter__(self) -> Self:
        """Return the membership itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the discovery, destroy the node and leave the domain."""
        close_context(self._context, [self.node], [self.discovery.close])
