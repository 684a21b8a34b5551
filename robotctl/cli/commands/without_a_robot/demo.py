"""demo: one recorded lap with a simulated robot."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from robotctl.base.domains import reserved_domain
from robotctl.base.errors import NoDaemon, RobotctlError
from robotctl.cli.commands.daemon.watch import POLL_S, polled_until, show
from robotctl.cli.commands.robot.drive import tracking_lines
from robotctl.cli.commands.robot.drive.running import write_picture
from robotctl.cli.options import Json, new_app
from robotctl.cli.quick import stop_daemon
from robotctl.cli.targets.interrupts import Background, ignoring, interrupted_by
from robotctl.cli.targets.launch import INTERRUPTIONS, StartOptions, launch
from robotctl.cli.targets.requests import request_source
from robotctl.cli.ui.status import TopicLines
from robotctl.cli.ui.text import (
    can_show_braille,
    is_terminal,
    json_text,
    printable,
    short_path,
    size,
    terminal_lines,
)
from robotctl.ipc.answers import DriveAnswer, Status
from robotctl.ipc.client import call, command_for
from robotctl.ipc.method_names import DRIVE, PATH, STATUS
from robotctl.show.figure import Path2D, path_figure
from robotctl.show.terminal import ground_lines

app = new_app()

CONFIG = Path(__file__).with_name("demo.yaml")

SIDE_M = 1.0

SENSORS_DEADLINE_S = 20.0
"""How long the first odometry and battery may take [s]: usually 1 s, more under load."""

MAP_ROWS = range(5, 19)
"""How high the map of the path may be [lines]."""

LINES_AROUND_MAP = 10
"""How many lines the last screen has for captions, commands and the next prompt."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """The answer about the drive, the status afterwards, and the reference and driven path."""

    drive: DriveAnswer
    status: Status
    reference: Path2D
    driven: Path2D

    @property
    def folder(self) -> Path:
        """The folder of the recording."""
        return Path(self.status["recorder"]["file"]).parent

    @property
    def missing_messages(self) -> int:
        """The number of messages that were sent but not recorded."""
        recorder = self.status["recorder"]
        return int(recorder["lost"]) + int(recorder["dropped"])


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
    robot = f"demo_{os.getpid()}"
    with reserved_domain() as domain_id:
        options = StartOptions(
            robot, config=CONFIG, recordings=recordings, sim=True, domain_id=domain_id
        )
        if not as_json:
            print(f"starting a simulated robot: {robot}, ROS domain {domain_id}", flush=True)
        with _daemon(options, keep=keep):
            result = _drive_one_lap(robot, quiet=as_json)
    png = write_picture(result.folder, robot, result.reference, result.driven, result.drive)
    if as_json:
        print(json_text(_as_object(robot, result, png)))
    else:
        print("\n".join(_report(robot, result, png, keep=keep)))


@contextmanager
def _daemon(options: StartOptions, *, keep: bool) -> Iterator[None]:
    """Run a daemon during the block; with `keep`, it continues after a block without error."""
    with interrupted_by(INTERRUPTIONS):
        try:
            for note in launch(options).get("notes") or []:
                print(f"note: {printable(note)}", file=sys.stderr)
            yield
            if not keep:
                with ignoring(INTERRUPTIONS):
                    _stop_if_running(options.robot)
        except BaseException:
            with ignoring(INTERRUPTIONS):
                file = _recording_of(options.robot)
                if file is not None:
                    _stop_if_running(options.robot)
                    print(f"stopped; recorded until then: {file}", file=sys.stderr)
            raise


def _drive_one_lap(robot: str, *, quiet: bool) -> DemoResult:
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
    result = drive.result()
    path = call(robot, PATH)
    return DemoResult(result, call(robot, STATUS), path["reference"], path["driven"])


def _wait_for_sensors(robot: str) -> None:
    """Wait until the daemon knows the robot's pose and battery level.

    Raises:
        RobotctlError: The daemon does not know them by the deadline.
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
    """Return the file that the robot's daemon writes, or None if there is no daemon."""
    try:
        return short_path(call(robot, STATUS)["recorder"]["file"])
    except NoDaemon:
        return None


def _stop_if_running(robot: str) -> None:
    with suppress(NoDaemon):
        stop_daemon(robot)


def _as_object(robot: str, result: DemoResult, png: Path) -> dict[str, Any]:
    from robotctl.recording import read_info

    topics = read_info(result.folder).topics
    return {
        "robot": robot,
        "recording": str(result.folder),
        "picture": str(png),
        "messages": {topic.name: topic.message_count for topic in topics},
        "lost": result.missing_messages,
        **result.drive,
    }


def _report(robot: str, result: DemoResult, png: Path, *, keep: bool) -> Iterator[str]:
    from robotctl.recording import read_info

    found = read_info(result.folder)
    folder = short_path(result.folder)
    heard = [topic for topic in found.topics if topic.message_count]
    table = TopicLines((topic.name, topic.type_name) for topic in heard)
    yield f"\n{table.header}"
    for topic in heard:
        yield table.row(topic.name, topic.type_name, topic.message_count, topic.rate_hz)
    if len(heard) < len(found.topics):
        yield f"  and {len(found.topics) - len(heard)} more without messages"
    figures = [
        f"  recording   {folder} ({size(found.size_bytes)})",
        f"  picture     {short_path(png)}",
        f"  messages    {found.message_count}, {result.missing_messages} lost",
        *tracking_lines(result.drive),
    ]
    if can_show_braille():
        colour = is_terminal() and not os.environ.get("NO_COLOR")
        rows = terminal_lines() - len(figures) - LINES_AROUND_MAP
        rows = min(max(rows, min(MAP_ROWS)), max(MAP_ROWS))
        yield "\n  driven path (line) and reference path (dots)"
        figure = path_figure(result.reference, result.driven)
        yield from ground_lines(figure, rows=rows, colour=colour)
    yield ""
    yield from figures
    yield "\nnext:"
    yield from (f"  {command}" for command in _next_commands(robot, folder, keep=keep))


def _next_commands(robot: str, folder: str, *, keep: bool) -> list[str]:
    """Return three commands to continue with, ready to paste."""
    recording = shlex.quote(folder)
    if keep:
        return [
            command_for(robot, "watch"),
            f"robotctl info {recording}",
            command_for(robot, "stop"),
        ]
    return [f"robotctl report {recording}", f"robotctl replay {recording}", "robotctl start"]
