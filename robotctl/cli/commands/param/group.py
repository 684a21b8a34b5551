"""The group `param`, to which each command adds itself."""

from __future__ import annotations

from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="param")


@group.callback()
def param() -> None:
    """List, read and change the parameters of the daemon.

    \b
    Examples:
      robotctl param list
      robotctl param get limits.linear_mps
      robotctl param set limits.linear_mps 0.4
      robotctl param dump > robot.yaml
    """
