"""boot: start the daemon of a robot at boot, by systemd."""

from robotctl.cli.commands.boot import install, remove, show
from robotctl.cli.commands.boot.group import app

__all__ = ["app", "install", "remove", "show"]
