"""service: list services, and call one."""

from __future__ import annotations

from robotctl.cli.commands.service.call import call_service
from robotctl.cli.commands.service.listing import list_services
from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="service")


@group.callback()
def service() -> None:
    """Show the services on ROS, and call them.

    \b
    Examples:
      robotctl service list -t
      robotctl service call /set_mode "{requested_mode: 1}"
    """


group.command("list")(list_services)
group.command("call")(call_service)
