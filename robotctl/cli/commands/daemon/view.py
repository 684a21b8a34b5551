"""view: show a running robot in Foxglove or Lichtblick."""

from __future__ import annotations

from typing import Annotated

import typer

from robotctl.base.errors import UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli.options import Json, Robot, new_app

app = new_app()

MAX_PORT = 65_535


@app.command()
def view(
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Listen on this address.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(metavar="N", help="Listen on this port [default: 8765, or a free one]."),
    ] = None,
    origin: Annotated[
        list[str] | None,
        typer.Option(metavar="URL", help="Let pages of this origin connect, too; repeatable."),
    ] = None,
    control: Annotated[
        bool,
        typer.Option("--control", help="Let viewers stop the robot, and drive it with the lease."),
    ] = False,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Show a running robot live in Foxglove or Lichtblick.

    It prints a URL for "Open connection", "Foxglove WebSocket". The URL has a token of this run:
    without --control one may read with it, and cannot move the robot. A layout is
    docs/foxglove-layout.json.

    The view is a process of its own with a ROS node of its own: a slow viewer loses messages, which
    it is told, and delays no other part. It ends with Ctrl-C, or with the daemon. Recordings are
    MCAP files, which Foxglove and Lichtblick open themselves.

    With --control, viewers may call the services /estop and /stop. Below `robotctl lease take` they
    may drive as well, by geometry_msgs/msg/Twist ten times a second or more.

    \b
    Examples:
      robotctl view
      robotctl view --port 9000
      robotctl view --control
      robotctl view --origin https://lichtblick.example.org
    """
    if port is not None and not 0 <= port <= MAX_PORT:
        raise UsageError(f"--port {port}", f"use 1 to {MAX_PORT}, or 0 for a free one")
    from robotctl.view.view_job import ViewJob, is_origin

    if wrong := [each for each in origin or () if not is_origin(each)]:
        raise UsageError(
            f"--origin {wrong[0]} is no origin",
            "use a scheme and a host without a path, such as https://lichtblick.example.org",
        )
    from robotctl.cli.targets.launch import check_view_installed, live_target, show_view
    from robotctl.cli.targets.requests import own_token

    check_view_installed()
    job = ViewJob(
        live=live_target(robot),
        host=host,
        port=port,
        origins=tuple(origin or ()),
        control=control,
        lease=(own_token() or "") if control else "",
    )
    show_view(job, as_json=as_json)
