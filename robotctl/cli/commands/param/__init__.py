"""param: list, read and change the parameters of a running daemon."""

from robotctl.cli.commands.param import dump, get, list_all, set_one
from robotctl.cli.commands.param.group import app

__all__ = ["app", "dump", "get", "list_all", "set_one"]
