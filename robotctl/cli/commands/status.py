"""status, ps, watch, view: show a robot's status, list all robots, and show one live."""

from __future__ import annotations

import json
import select
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Annotated, Any, Final

import typer

from robotctl.base.errors import Refused, RobotctlError, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.cli import quick
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.quick import mode_number
from robotctl.cli.targets import robots
from robotctl.cli.targets.driving import Background
from robotctl.cli.targets.requests import asked_by, lease_of_shell
from robotctl.cli.ui.keys import Keyboard
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.status import is_observer, mode_text
from robotctl.cli.ui.text import is_terminal, number, printable, short_path
from robotctl.ipc.answers import DrivenPath, Status
from robotctl.ipc.client import Client, call
from robotctl.ipc.method_names import PATH, SET_MODE, STATUS
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

app = new_app()


@app.command()
def status(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Show mode, pose, battery, recorder and topics on one screen.

    \b
    Examples:
      robotctl status
      robotctl status --json | jq .mode
    """
    quick.status(robot, as_json)


@app.command()
def ps(as_json: Json = False) -> None:
    """List every robot of this user: mode, pid and recording.

    \b
    Examples:
      robotctl ps
      robotctl ps --json
    """
    answers = [_answer(each) for each in robots.find(robots.names())]
    print_answer({"robots": answers}, _lines(answers), as_json=as_json)


def _answer(found: robots.RobotDaemon) -> dict[str, Any]:
    status = found.status
    return {
        "robot": found.robot,
        "mode": None if status is None else status["mode"],
        "pid": None if status is None else status["pid"],
        "recording": "" if status is None else status["recorder"]["file"],
        "lease": None if status is None else status["lease"],
        "problem": found.problem,
    }


def _lines(answers: list[dict[str, Any]]) -> Iterator[str]:
    if not answers:
        yield "no daemon runs"
        return
    yield f"{'ROBOT':16} {'MODE':22} {'PID':>8}  RECORDING"
    for each in answers:
        if each["problem"]:
            yield f"{printable(each['robot']):16} {printable(each['problem'])}"
        else:
            recording = short_path(each["recording"]) if each["recording"] else ""
            yield f"{each['robot']:16} {mode_text(each):22} {each['pid']:>8}  {recording}"


POLL_S = 0.1
LINE_S = 1.0
"""The period of the status lines without a terminal [s]."""


_ROW = "{:>8} {:<14} {:>8} {:>8} {:>7} {:>7} {:>7} {:>8} {:>5}"
HEADER = _ROW.format(
    "up [s]", "mode", "x [m]", "y [m]", "theta", "v [m/s]", "battery", "written", "lost"
)


def status_line(status: Status) -> str:
    """Return the status as a line in the columns of HEADER, with `-` for an unknown value."""
    pose: Mapping[str, Any] = status["pose"] or {}
    velocity: Mapping[str, Any] = status["velocity"] or {}
    recorder = status["recorder"]
    cells = (
        _cell(status.get("uptime_s"), ".1f"),
        "observing" if is_observer(status) else printable(status.get("mode")),
        *(_cell(pose.get(key), ".3f") for key in ("x", "y", "theta")),
        _cell(velocity.get("linear"), ".3f"),
        _cell(status.get("battery"), ".0%"),
        _cell(recorder.get("written"), "d"),
        _cell(recorder.get("lost"), "d"),
    )
    return _ROW.format(*cells)


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else number(value, form)


def polled_until(working: Background[Any], robot: str) -> Iterator[Status]:
    """Poll and yield the daemon's status until the thread `working` is done.

    Nothing is yielded in the first POLL_S, and for a poll that fails.
    """
    period_s = POLL_S if is_terminal() else LINE_S
    working.join(POLL_S)
    while not working.is_done:
        try:
            status = call(robot, STATUS)
        except RobotctlError:
            pass
        else:
            yield status
        time.sleep(period_s)


def show(statuses: Iterator[Status]) -> None:
    """Draw each status over the previous one; without a terminal, print a line for each."""
    if not is_terminal():
        for row, status in enumerate(statuses):
            if row == 0:
                print(HEADER)
            print(status_line(status), flush=True)
        return
    from rich.live import Live

    from robotctl.cli.ui.panels import live_view

    with Live(auto_refresh=False) as live:
        for status in statuses:
            live.update(live_view(status), refresh=True)


KEYS: Final = "space stop   e emergency stop   q quit"

PATH_S: Final = 1.0
"""The period of the requests for the driven path [s]."""


def watch_on_screen(robot: str) -> None:
    """Draw the status until `q` is pressed; the space bar and `e` stop the robot.

    Raises:
        NoDaemon: The daemon has ended.
    """
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    from robotctl.cli.ui.panels import History, drive_map, live_view

    history = History()
    note = ""
    path: DrivenPath = {"reference": [], "driven": []}
    path_due_s = 0.0
    with (
        Client(robot) as client,
        Live(auto_refresh=False, screen=True, redirect_stdout=False) as live,
        Keyboard(live.stop, live.start) as keyboard,
    ):
        while True:
            status = client.call(STATUS)
            if time.monotonic() >= path_due_s:
                path_due_s = time.monotonic() + PATH_S
                with suppress(Refused):  # nothing was driven yet
                    path = client.call(PATH)
            history.add(status)
            seen = drive_map(path, history, live.console.size.height)
            keys = Text(note or KEYS, style="dim", no_wrap=True, overflow="ellipsis")
            live.update(Group(live_view(status, beside=seen), keys), refresh=True)
            for key in _pressed(keyboard):
                if key == "q":
                    return
                note = _stopped(robot, key) or note


def _pressed(keyboard: Keyboard) -> str:
    """Return the keys of the next POLL_S, "" for none, or `q` if the terminal is closed."""
    if not keyboard.sources:
        time.sleep(POLL_S)
        return ""
    ready, _, _ = select.select(keyboard.sources, [], [], POLL_S)
    keys = keyboard.read() if ready else ""
    return "q" if not keys and keyboard.has_ended(ready) else keys


def _stopped(robot: str, key: str) -> str:
    """Stop the robot if `key` is a stop key; return the text to show, "" for any other key."""
    told = {" ": "stopped with a ramp", "e": "emergency stop, released by robotctl reset"}
    if key not in told:
        return ""
    mode = mode_number("idle") if key == " " else EMERGENCY_STOP_MODE
    try:
        call(robot, SET_MODE, {"mode": mode, **asked_by("watch"), **lease_of_shell()})
    except RobotctlError as error:
        return str(error)
    return f"{told[key]}   {KEYS}"


@app.command()
def watch(robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Watch mode, pose, speed, path, battery, recorder and topics, live.

    Space stops the robot with a ramp, e is the emergency stop, q or Ctrl-C ends the view. It ends
    with the daemon, too. Without a terminal, or with --json, it prints one line per second.

    \b
    Examples:
      robotctl watch
      robotctl watch | tee run.log
      robotctl watch --json | jq .pose
    """
    if as_json:
        for status in _each_second(robot):
            print(json.dumps(status), flush=True)
    elif not is_terminal():
        show(_each_second(robot))
    else:
        watch_on_screen(robot)


def _each_second(robot: str) -> Iterator[Status]:
    """Yield the daemon's status each second.

    Raises:
        NoDaemon: The daemon has ended.
    """
    while True:
        yield call(robot, STATUS)
        time.sleep(LINE_S)


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
    without --control it only allows reading, and cannot move the robot. A layout is
    docs/foxglove-layout.json.

    The view is a process of its own with a ROS node of its own: a slow viewer loses messages, is
    told how many, and delays no other part. The view ends with Ctrl-C, or with the daemon.
    Recordings are MCAP files, which Foxglove and Lichtblick open themselves.

    With --control, viewers may call the services /estop and /stop. Within `robotctl lease take`
    they may drive as well, by geometry_msgs/msg/Twist ten times a second or more.

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
