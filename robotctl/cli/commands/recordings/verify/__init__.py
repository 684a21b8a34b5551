"""verify: check whether recordings are whole, and whether their seals are unbroken."""

from __future__ import annotations

from robotctl.cli.commands.recordings.verify.command import app

__all__ = ["app"]
