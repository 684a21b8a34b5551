# mypy: disallow-untyped-calls=False
"""A process's part in a ROS domain, of which nothing remains on the disk."""

from __future__ import annotations

from typing import Final

from rclpy.context import Context

_NO_LOG_FILE: Final = ("--ros-args", "--disable-external-lib-logs")
"""Nothing of ours is logged through rcl, which would leave an empty file in the user's home with
every command, and not begin at all where it cannot be written."""


def open_context(domain_id: int) -> Context:
    """Return a context in this domain; it hears neither of our command line nor of signals."""
    context = Context()
    context.init(args=list(_NO_LOG_FILE), domain_id=domain_id)
    return context
