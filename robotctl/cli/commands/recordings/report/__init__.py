"""report: a recording as one HTML page."""

from __future__ import annotations

from robotctl.cli.commands.recordings.report.command import app

__all__ = ["app"]
