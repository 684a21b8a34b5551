"""view: show a running robot or a recording in Foxglove or Lichtblick."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.support.time_argument import parse_moment
from robotctl.cli.terminal.text import short_path
from robotctl.errors import UsageError
from robotctl.paths import DEFAULT_ROBOT

app = new_app()

MAX_PORT = 65_535


@app.command()
def view(
    file: Annotated[
        str,
        typer.Argument(metavar="[FILE]", help="Play this recording, or the last one: last."),
    ] = "",
    at: Annotated[
        str | None,
        typer.Option(
            metavar="T", help="Begin there: seconds into the recording, 12:03:04, or a date."
        ),
    ] = None,
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
    """Show a running robot, live, or a recording in Foxglove or Lichtblick.

    It prints a URL for "Open connection", "Foxglove WebSocket". The URL has a token of this run:
    without --control one may read with it, and cannot move the robot. A layout is
    docs/foxglove-layout.json.

    The view is a process of its own with a ROS node of its own: a slow viewer loses messages, which
    it is told, and delays no other part. It ends with Ctrl-C, or with the daemon. A recording plays
    without ROS; Foxglove pauses it, seeks and sets the speed.

    With --control, viewers may call the services /estop and /stop. Below `robotctl lease take` they
    may drive as well, by geometry_msgs/msg/Twist ten times a second or more.

    \b
    Examples:
      robotctl view
      robotctl view last
      robotctl view last --at 12:03:04
      robotctl view recordings/robot_20261123_101500 --port 9000
      robotctl view --control
      robotctl view --origin https://lichtblick.example.org
    """
    if port is not None and not 0 <= port <= MAX_PORT:
        raise UsageError(f"--port {port}", f"use 1 to {MAX_PORT}, or 0 for a free one")
    if control and file:
        raise UsageError("--control with a recording", "leave one of them out")
    if at is not None and not file:
        raise UsageError("--at without a recording", "name one, or `last`")
    from robotctl.view.view_job import ViewJob, is_origin

    if wrong := [each for each in origin or () if not is_origin(each)]:
        raise UsageError(
            f"--origin {wrong[0]} is no origin",
            "use a scheme and a host without a path, such as https://lichtblick.example.org",
        )
    from robotctl.cli.support.lease_token import own_token
    from robotctl.cli.support.recording_paths import find_local_recording
    from robotctl.cli.support.view_process import check_view_installed, live_target, show_view

    check_view_installed()
    if file:
        path = find_local_recording(file, robot)
        job, what = ViewJob(file=str(path), at_ns=_moment(path, at)), short_path(path)
    else:
        lease = (own_token() or "") if control else ""
        job = ViewJob(live=live_target(robot), control=control, lease=lease)
        what = f"robot {robot}"
    job = replace(job, host=host, port=port, origins=tuple(origin or ()))
    show_view(job, what, as_json=as_json)


def _moment(path: Path, at: str | None) -> int:
    """Return where to begin [ns since the epoch], 0 for the beginning."""
    if at is None:
        return 0
    from robotctl.recording import read_info

    info = read_info(path)
    return parse_moment(at, info.start_ns, info.end_ns)
