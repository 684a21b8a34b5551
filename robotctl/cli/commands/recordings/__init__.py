"""recordings: list recordings, keep them from being removed, and remove them."""

from __future__ import annotations

from robotctl.cli.commands.recordings.group import app

__all__ = ["app"]
