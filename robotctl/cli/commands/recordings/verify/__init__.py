"""verify: is a recording whole, and is its seal unbroken?"""

from __future__ import annotations

from robotctl.cli.commands.recordings.verify.command import app

__all__ = ["app"]
