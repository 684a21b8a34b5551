"""sim, demo: run a simulated robot alone, or drive one over a recorded lap."""

from __future__ import annotations

import math
import os
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robotctl.base.domains import reserved_domain
from robotctl.base.errors import NoDaemon, RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT, check_namespace, check_robot_name, namespace_of
from robotctl.cli.commands.drive import tracking_lines, write_picture
from robotctl.cli.commands.status import POLL_S, polled_until, show
from robotctl.cli.options import ConfigFile, DomainId, Json, Namespace, Robot, new_app, new_group
from robotctl.cli.quick import stop_daemon
from robotctl.cli.targets.driving import Background, ignoring, interrupted_by
from robotctl.cli.targets.launch import INTERRUPTIONS, daemon_command, launch
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.status import topic_table
from robotctl.cli.ui.text import (
    can_show_braille,
    is_float,
    is_terminal,
    printable,
    short_path,
    size,
    terminal_lines,
)
from robotctl.ipc.answers import DriveAnswer, DrivenPath
from robotctl.ipc.client import call, command_for
from robotctl.ipc.method_names import DRIVE, PATH, SIM_FAULT, SIM_SET, STATUS
from robotctl.show.figure import path_figure
from robotctl.show.terminal import ground_lines
from robotctl.sim import MAX_FAULT_S, SimFault

if TYPE_CHECKING:
    from robotctl.recording import RecordingInfo

app = new_app()
group = new_group(app, "sim")


@group.callback(invoke_without_command=True)
def sim(
    context: typer.Context,
    robot: Robot = DEFAULT_ROBOT,
    namespace: Namespace = None,
    config: ConfigFile = None,
    domain_id: DomainId = None,
    auto: Annotated[
        bool, typer.Option("--auto", help="End at once where odometry is published already.")
    ] = False,
) -> None:
    """Run the simulated robot in a process of its own, until Ctrl-C.

    A daemon that is started afterwards finds it and drives it like a real robot. If that daemon
    dies, the simulated robot stops by its own command timeout. `set` and `fault` act on the robot
    that a daemon simulates itself (robotctl start --sim).

    \b
    Examples:
      robotctl sim
      robotctl sim --robot r2 --domain-id 5
      robotctl sim fault odom-lost --for 2s
    """
    if context.invoked_subcommand is not None:
        return
    from robotctl.base import environment

    note = environment.prepare()
    if note:
        print(f"note: {note}", file=sys.stderr)
    import asyncio

    from robotctl.base.domains import requested_domain
    from robotctl.config import Config, load
    from robotctl.daemon.simulator import simulate

    domain = requested_domain(domain_id) or 0
    name = check_robot_name(robot)
    full = namespace_of(name) if namespace is None else check_namespace(namespace)
    settings = Config() if config is None else load(config)

    def say_ready() -> None:
        print(f"simulated robot {robot} runs in ROS domain {domain} (Ctrl-C ends it)", flush=True)

    with ExitStack() as at_end:
        asyncio.run(
            simulate(
                settings,
                domain_id=domain,
                namespace=full,
                on_ready=say_ready,
                at_end=at_end,
                only_if_missing=auto,
            )
        )


@group.command("set")
def change(
    setting: Annotated[str, typer.Argument(metavar="battery=LEVEL", help="0 to 1.")],
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Set the battery level of the robot that the daemon simulates.

    \b
    Examples:
      robotctl sim set battery=0.1
    """
    answer = call(robot, SIM_SET, {"battery": _level(setting), "source": request_source("sim set")})
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def _level(setting: str) -> float:
    key, _, text = setting.partition("=")
    level = float(text) if key == "battery" and is_float(text) else -1.0
    if not 0.0 <= level <= 1.0:
        raise UsageError(f"{printable(setting)}", "use battery=0 to battery=1")
    return level


_NAMES = ", ".join(fault.value for fault in SimFault)
_UNITS = (("ms", 1e-3), ("s", 1.0), ("", 1.0))


@group.command("fault")
def fail(
    fault: Annotated[SimFault, typer.Argument(metavar="FAULT", help=f"One of {_NAMES}.")],
    duration: Annotated[
        str, typer.Option("--for", metavar="TIME", help="How long, such as 2s or 500ms.")
    ] = "2s",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Let the robot that the daemon simulates fail for a while, and tell when it stopped.

    The milliseconds count from the fault to the mode that commands zero.

    \b
    Examples:
      robotctl sim fault odom-lost --for 2s
      robotctl sim fault slip --for 5s
    """
    params = {
        "fault": fault.value,
        "for_s": seconds(duration),
        "source": request_source("sim fault"),
    }
    answer = call(robot, SIM_FAULT, params, deadline_s=None)
    print_answer(dict(answer), [printable(answer["message"])], as_json=as_json)


def seconds(text: str) -> float:
    """Return the seconds of a duration such as `2s` or `500ms`.

    Raises:
        UsageError: The text is no duration, or the duration is not above 0 or too long.
    """
    unit, factor = next((unit, factor) for unit, factor in _UNITS if text.endswith(unit))
    number = text.removesuffix(unit)
    found = float(number) * factor if is_float(number) else math.nan
    if not 0.0 < found <= MAX_FAULT_S:
        raise UsageError(f"--for {printable(text)}", f"use 1ms to {MAX_FAULT_S:g}s")
    return found


CONFIG = Path(__file__).with_name("demo.yaml")

SIDE_M = 1.0

SENSORS_DEADLINE_S = 20.0
"""The timeout of the first odometry and battery [s]: usually 1 s, more under load."""

MAP_ROWS = range(5, 19)
"""The height of the map [lines]."""

LINES_AROUND_MAP = 10
"""The lines of the last screen for captions, commands and the next prompt."""


@app.command()
def demo(
    recordings: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where to record [default: ./recordings].")
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="Leave the daemon running at the end.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Drive a simulated robot around a square and show the recording.

    Uses its own robot name and ROS domain, so it does not affect running daemons. Takes less than
    a minute; Ctrl-C ends it early and leaves a valid recording.

    \b
    Examples:
      robotctl demo
      robotctl demo --keep --recordings /tmp/demo
    """
    from robotctl.recording import read_info

    robot = f"demo_{os.getpid()}"
    with reserved_domain() as domain_id:
        options = {"config": CONFIG, "recordings": recordings, "domain-id": domain_id, "sim": True}
        if not as_json:
            print(f"starting a simulated robot: {robot}, ROS domain {domain_id}", flush=True)
        with _daemon(robot, daemon_command(robot, options, ()), keep=keep):
            drive = _drive_one_lap(robot, quiet=as_json)
            path, recorder = call(robot, PATH), call(robot, STATUS)["recorder"]
    folder, missing = Path(recorder["file"]).parent, recorder["lost"] + recorder["dropped"]
    png = write_picture(folder, robot, path["reference"], path["driven"], drive)
    found = read_info(folder)
    answer = {
        "robot": robot,
        "recording": str(folder),
        "picture": str(png),
        "messages": {topic.name: topic.message_count for topic in found.topics},
        "lost": missing,
        **drive,
    }
    figures = [
        f"  recording   {short_path(folder)} ({size(found.size_bytes)})",
        f"  picture     {short_path(png)}",
        f"  messages    {found.message_count}, {missing} lost",
        *tracking_lines(drive),
    ]
    next_commands = _next_commands(robot, short_path(folder), keep=keep)
    lines = [*_topic_lines(found), *_map_lines(path, len(figures)), "", *figures, *next_commands]
    print_answer(answer, lines, as_json=as_json)


@contextmanager
def _daemon(robot: str, command: Sequence[str], *, keep: bool) -> Iterator[None]:
    """Run a daemon during the block; with `keep`, it continues after a block without an error."""
    with interrupted_by(INTERRUPTIONS):
        try:
            for note in launch(robot, command).get("notes") or []:
                print(f"note: {printable(note)}", file=sys.stderr)
            yield
            if not keep:
                with ignoring(INTERRUPTIONS):
                    _stop_if_running(robot)
        except BaseException:
            with ignoring(INTERRUPTIONS):
                file = _recording_of(robot)
                if file is not None:
                    _stop_if_running(robot)
                    print(f"stopped; recorded until then: {file}", file=sys.stderr)
            raise


def _drive_one_lap(robot: str, *, quiet: bool) -> DriveAnswer:
    params = {
        "pattern": "square",
        "side_m": SIDE_M,
        "laps": 1,
        "wait": True,
        "source": request_source("demo"),
    }
    _wait_for_sensors(robot)
    drive: Background[DriveAnswer] = Background(
        partial(call, robot, DRIVE, params, deadline_s=None)
    )
    drive.start()
    if not quiet:
        show(polled_until(drive, robot))
    return drive.result()


def _wait_for_sensors(robot: str) -> None:
    """Wait until the daemon knows the robot's pose and battery level.

    Raises:
        RobotctlError: The pose or the battery level is unknown at the deadline.
    """
    until = time.monotonic() + SENSORS_DEADLINE_S
    while time.monotonic() < until:
        status = call(robot, STATUS)
        if status.get("pose") is not None and status.get("battery") is not None:
            return
        time.sleep(POLL_S)
    raise RobotctlError(
        f"the simulated robot sent no odometry within {SENSORS_DEADLINE_S:g} s "
        "(is UDP on the loopback interface blocked?)"
    )


def _recording_of(robot: str) -> str | None:
    """Return the file of the daemon's recording, or None without a daemon."""
    try:
        return short_path(call(robot, STATUS)["recorder"]["file"])
    except NoDaemon:
        return None


def _stop_if_running(robot: str) -> None:
    with suppress(NoDaemon):
        stop_daemon(robot)


def _topic_lines(found: RecordingInfo) -> list[str]:
    heard = [topic for topic in found.topics if topic.message_count]
    lines = topic_table(
        (topic.name, topic.type_name, topic.message_count, topic.rate_hz) for topic in heard
    )
    silent = len(found.topics) - len(heard)
    return ["", *lines, *([f"  and {silent} more without messages"] if silent else [])]


def _map_lines(path: DrivenPath, others: int) -> Iterator[str]:
    """Yield the map of a drive, as high as the terminal allows with `others` more lines."""
    if can_show_braille():
        colour = is_terminal() and not os.environ.get("NO_COLOR")
        rows = terminal_lines() - others - LINES_AROUND_MAP
        rows = min(max(rows, min(MAP_ROWS)), max(MAP_ROWS))
        yield "\n  driven path (line) and reference path (dots)"
        figure = path_figure(path["reference"], path["driven"])
        yield from ground_lines(figure, rows=rows, colour=colour)


def _next_commands(robot: str, folder: str, *, keep: bool) -> list[str]:
    """Return three commands to continue with."""
    recording = shlex.quote(folder)
    commands = [f"robotctl report {recording}", f"robotctl replay {recording}", "robotctl start"]
    if keep:
        info = f"robotctl info {recording}"
        commands = [command_for(robot, "watch"), info, command_for(robot, "stop")]
    return ["\nnext:", *(f"  {command}" for command in commands)]
