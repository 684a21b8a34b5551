"""commission: measure a base by three short motions, and propose limits and gains for it."""

from __future__ import annotations

from robotctl.cli.commands.commission.command import app

__all__ = ["app"]
