"""The group `lease`, to which each command adds itself."""

from __future__ import annotations

from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="lease")


@group.callback()
def lease() -> None:
    """Take the sole right to start and steer motion; anybody may still stop.

    \b
    Examples:
      robotctl lease take -- bash
      robotctl lease status
      robotctl lease release
    """
