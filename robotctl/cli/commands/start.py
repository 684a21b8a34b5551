"""start, stop: start the daemon in the background or in this terminal, and end it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl import __version__
from robotctl.base import ros_arguments
from robotctl.base.errors import RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT, check_namespace, check_robot_name
from robotctl.base.ros_arguments import read_log_level
from robotctl.cli import quick
from robotctl.cli.options import (
    ConfigFile,
    DomainId,
    Json,
    Namespace,
    ProfileName,
    Robot,
    RosWords,
    new_app,
)
from robotctl.cli.targets.driving import interrupted_by
from robotctl.cli.targets.launch import (
    INTERRUPTIONS,
    check_view_installed,
    daemon_command,
    launch,
    start_view_of,
)
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.status import mode_text
from robotctl.cli.ui.text import printable, short_path
from robotctl.ipc.answers import StartSummary
from robotctl.ipc.client import command_for
from robotctl.kernel.patterns import PatternKind

app = new_app()


@app.command()
def start(
    robot: Robot = DEFAULT_ROBOT,
    namespace: Namespace = None,
    config: ConfigFile = None,
    profile: ProfileName = None,
    recordings: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where to record [default: ./recordings].")
    ] = None,
    drive: Annotated[
        PatternKind | None, typer.Option(metavar="PATTERN", help="Drive this pattern at once.")
    ] = None,
    sim: Annotated[
        bool | None,
        typer.Option(
            "--sim/--no-sim",
            help="With or without the simulated robot [default: simulate, unless "
            "odometry is already published].",
        ),
    ] = None,
    observe: Annotated[
        bool,
        typer.Option("--observe", help="Only record: publish no commands and control no robot."),
    ] = False,
    include: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Record only these topics; repeatable."),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Do not record these topics; repeatable."),
    ] = None,
    domain_id: DomainId = None,
    view: Annotated[
        bool, typer.Option("--view", help="Show it in Foxglove, too, as robotctl view does.")
    ] = False,
    foreground: Annotated[
        bool, typer.Option("--foreground", help="Stay in the terminal, for systemd and containers.")
    ] = False,
    allow_same_names: Annotated[
        bool,
        typer.Option(
            "--allow-same-names", help="Start beside a daemon whose nodes have the same names."
        ),
    ] = False,
    log_level: Annotated[
        list[str] | None,
        typer.Option(metavar="LEVEL", help="debug, info, warn, error or fatal; LOGGER:=LEVEL."),
    ] = None,
    ros_words: RosWords = None,
    as_json: Json = False,
) -> None:
    """Start the daemon and return when it is ready.

    It records every topic from the first message on. The robot does not move until you ask for it.

    To record, a PATTERN is a topic (/scan), a glob (/camera/*) or a type
    (type:sensor_msgs/msg/Image), or several separated by commas. Command, odometry, robot status
    and journal are always recorded: `why` and `replay --check` need them.

    After --ros-args come the arguments of ROS: -p KEY:=VALUE, --params-file FILE, -r FROM:=TO,
    -r __ns:=/NAMESPACE, -r NODE:__node:=NAME, --log-level LEVEL.

    \b
    Examples:
      robotctl start
      robotctl start --drive circle --view
      robotctl start --no-sim --config robot.yaml --recordings /data
      robotctl start --no-sim --profile turtlebot3
      robotctl start --robot r2 --domain-id 5
      robotctl start --observe --recordings /data
      robotctl start --ros-args -p limits.linear_mps:=0.4 -r odom:=/base/odom
      robotctl start --exclude '/camera/*,type:sensor_msgs/msg/PointCloud2'
    """
    if foreground and as_json:
        raise UsageError("--foreground with --json", "leave --json out: the output is JSON anyway")
    if foreground and view:
        raise UsageError("--foreground with --view", "run robotctl view in another terminal")
    if view:
        check_view_installed()
    if config is not None and profile is not None:
        cure = f"copy the profile: robotctl config show --profile {profile.value} > robot.yaml"
        raise UsageError("--config with --profile", cure)
    options = {
        "namespace": None if namespace is None else check_namespace(namespace),
        "config": config if profile is None else profile.path,
        "recordings": recordings,
        "drive": None if drive is None else drive.value,
        "domain-id": domain_id,
        "sim": sim is True,
        "no-sim": sim is False,
        "observe": observe,
        "allow-same-names": allow_same_names,
        "include": include,
        "exclude": exclude,
        "log-level": log_level,
    }
    for level in log_level or ():
        read_log_level(level)
    ros_arguments.parse(ros_words or ())
    words = [ros_arguments.BEGIN, *ros_words, ros_arguments.END] if ros_words else []
    command = daemon_command(check_robot_name(robot), options, words)
    if foreground:
        os.execv(command[0], command)

    def on_ready(ready: StartSummary) -> None:
        shown = {"view": _view_of(robot, ready)} if view else {}
        lines = [
            *summary(ready),
            *(f"  view        {each['url']}" for each in shown.values() if each),
        ]
        print_answer({**ready, **shown}, lines, as_json=as_json)

    with interrupted_by(INTERRUPTIONS):
        launch(robot, command, on_ready)


def _view_of(robot: str, ready: StartSummary) -> dict[str, Any] | None:
    """Start a view and return its report; on failure, add a note to `ready` and return None."""
    try:
        return start_view_of(robot)
    except RobotctlError as error:
        ready.setdefault("notes", []).append(f"there is no view: {error}")
        return None


def summary(ready: StartSummary) -> list[str]:
    """Return the lines to print after the start; `ready` is the daemon's report."""
    robot, sim = printable(ready.get("robot")), ready.get("sim")
    domain, discovery = ready.get("domain_id"), printable(ready.get("discovery_range"))
    latched = f"the emergency stop is still latched; release it with: {command_for(robot, 'reset')}"
    return [
        f"robotctl {__version__}: robot {robot} is ready",
        f"  mode        {mode_text(ready)}",
        f"  ROS         domain {domain}, discovery {discovery}",
        *([] if sim is None else [f"  simulator   {'yes' if sim else 'no'}"]),
        f"  socket      {printable(ready.get('socket'))}",
        f"  recording   {short_path(ready.get('recording'))}",
        f"  log         {printable(ready.get('log'))}",
        f"  pid         {ready.get('pid')}",
        *(f"note: {printable(note)}" for note in ready.get("notes") or []),
        *([latched] if ready.get("mode") == "EMERGENCY_STOP" else []),
    ]


@app.command()
def stop(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the robot, close the recording and end the daemon.

    Returns when the process has ended.

    \b
    Examples:
      robotctl stop
    """
    quick.stop(robot, as_json)
