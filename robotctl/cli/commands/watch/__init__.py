"""watch: show the status of a running daemon, live."""

from __future__ import annotations

from robotctl.cli.commands.watch.command import app

__all__ = ["app"]
