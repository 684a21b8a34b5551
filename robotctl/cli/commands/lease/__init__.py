"""lease: who alone may start and steer motion."""

from robotctl.cli.commands.lease import release, status, take
from robotctl.cli.commands.lease.group import app

__all__ = ["app", "release", "status", "take"]
