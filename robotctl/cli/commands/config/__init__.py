"""config: show and check configurations, and the profiles of known robots."""

from __future__ import annotations

from robotctl.cli.commands.config.show import show
from robotctl.cli.commands.config.validate import validate
from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="config")


@group.callback()
def config() -> None:
    """Show and check configuration files, and profiles of robots.

    \b
    Examples:
      robotctl config show --profile turtlebot3 > robot.yaml
      robotctl config validate robot.yaml
    """


group.command()(show)
group.command()(validate)
