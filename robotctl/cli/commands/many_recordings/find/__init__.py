"""find: search all recordings of a folder for drives, recordings, events or topics."""

from __future__ import annotations

from robotctl.cli.commands.many_recordings.find.command import app

__all__ = ["app"]
