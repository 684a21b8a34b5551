"""The live view on the whole terminal, with keys."""

from __future__ import annotations

import select
import time
from typing import Final

from rich.console import Group
from rich.live import Live
from rich.text import Text

from robotctl.cli.commands.watch.polling import POLL_S
from robotctl.cli.support.quick_actions import asked_by, lease_of_shell, mode_number
from robotctl.cli.terminal.drive_map import History, drive_map
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.status_panel import live_view
from robotctl.errors import Refused, RobotctlError
from robotctl.ipc.answers import DrivenPath
from robotctl.ipc.client import Client, call
from robotctl.ipc.method_names import PATH, SET_MODE, STATUS
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE

KEYS: Final = "space stop   e emergency stop   q quit"

PATH_S: Final = 1.0
"""How often the map is drawn again."""


def watch_on_screen(robot: str) -> None:
    """Draw the status until `q`, and stop the robot by keys.

    Raises:
        NoDaemon: The daemon has ended.
    """
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
                path, path_due_s = _path(client), time.monotonic() + PATH_S
            history.add(status)
            seen = drive_map(path, history, live.console.size.height)
            keys = Text(note or KEYS, style="dim", no_wrap=True, overflow="ellipsis")
            live.update(Group(live_view(status, beside=seen), keys), refresh=True)
            for key in _pressed(keyboard):
                if key == "q":
                    return
                note = _stopped(robot, key) or note


def _path(client: Client) -> DrivenPath:
    try:
        return client.call(PATH)
    except Refused:  # nothing was driven yet
        return {"reference": [], "driven": []}


def _pressed(keyboard: Keyboard) -> str:
    """Wait for a poll's time; return the keys that were pressed meanwhile."""
    if not keyboard.sources:
        time.sleep(POLL_S)
        return ""
    ready, _, _ = select.select(keyboard.sources, [], [], POLL_S)
    keys = keyboard.read() if ready else ""
    return "q" if not keys and keyboard.has_ended(ready) else keys


def _stopped(robot: str, key: str) -> str:
    """Stop the robot if the key says so; return what to tell."""
    told = {" ": "stopped with a ramp", "e": "emergency stop, released by robotctl reset"}
    if key not in told:
        return ""
    mode = mode_number("idle") if key == " " else EMERGENCY_STOP_MODE
    try:
        call(robot, SET_MODE, {"mode": mode, **asked_by("watch"), **lease_of_shell()})
    except RobotctlError as error:
        return str(error)
    return f"{told[key]}   {KEYS}"
