"""Taking part in a ROS domain, before anything is published there."""

from __future__ import annotations

import time
from typing import Final, Self

from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.domains import is_certainly_empty
from robotctl.ros.context import close_context, open_context

NODE_NAME: Final = "robotctl_replay"


class Membership:
    """A node in a ROS domain, for the `with` block; threads of the middleware discover others.

    It costs no module of messages, which bring numpy: what else is needed can be imported while
    others are discovered.
    """

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        self.was_certainly_empty = is_certainly_empty(domain_id)
        """Nobody was in the domain."""

        self.since_s = time.monotonic()
        self._context = open_context(domain_id)
        self.node = Node(
            NODE_NAME,
            context=self._context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )

    def __enter__(self) -> Self:
        """The member itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave, with everything that the node has made."""
        close_context(self._context, [self.node])
