"""sim: the simulated robot, alone or as it fails."""

from robotctl.cli.commands.sim import change, fail
from robotctl.cli.commands.sim.group import app

__all__ = ["app", "change", "fail"]
