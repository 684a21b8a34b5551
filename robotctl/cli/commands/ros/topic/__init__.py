"""topic: list topics, show their messages, rates and endpoints."""

from __future__ import annotations

from robotctl.cli.commands.ros.topic.command import echo, hz, info, list_topics
from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="topic")


@group.callback()
def topic() -> None:
    """Show topics and their messages, live or in a recording.

    \b
    Examples:
      robotctl topic list
      robotctl topic echo /odom pose.pose.position.x
      robotctl topic hz --file last /odom
    """


group.command("list")(list_topics)
group.command("echo")(echo)
group.command("hz")(hz)
group.command("info")(info)
