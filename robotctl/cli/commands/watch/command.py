"""watch: the live view with its keys, lines through a pipe, JSON for machines."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

from robotctl.cli.commands.watch.polling import LINE_S, show
from robotctl.cli.options import Json, Robot, new_app
from robotctl.cli.terminal.text import is_terminal
from robotctl.ipc.answers import Status
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS
from robotctl.paths import DEFAULT_ROBOT

app = new_app()


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
        from robotctl.cli.commands.watch.screen import watch_on_screen

        watch_on_screen(robot)


def _each_second(robot: str) -> Iterator[Status]:
    """Yield the status of the daemon until the daemon ends, with NoDaemon."""
    while True:
        yield call(robot, STATUS)
        time.sleep(LINE_S)
