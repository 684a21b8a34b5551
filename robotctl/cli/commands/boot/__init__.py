"""boot: start the daemon of a robot at boot, by systemd."""

from robotctl.cli.commands.boot import copies, install, remove, show
from robotctl.cli.commands.boot.group import app

__all__ = ["app", "copies", "install", "remove", "show"]
