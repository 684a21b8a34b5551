"""Start the process that plays a recording, show its reports, send it keys, and end it."""

from __future__ import annotations

import select
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any, Final

from robotctl.cli.commands.replay.keys import KEYS, QUIT
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.replay_screen import Screen
from robotctl.errors import RobotctlError, error_for_exit_code
from robotctl.processes import Child, program, start
from robotctl.replay.commands import Command
from robotctl.replay.job import Job

PLAYER: Final = "robotctl.replay"
"""The module of the process that plays."""

END_DEADLINE_S = 15.0
"""How long the player may take to remove its publishers from the graph and exit."""


@dataclass(slots=True)
class PlayerReport:
    """What the player process has reported so far."""

    summary: dict[str, Any] = field(default_factory=dict)
    error: RobotctlError | None = None
    interrupted: bool = False
    """Whether Ctrl-C or a signal has ended the replay."""
    ended: bool = False
    """Whether the player will report nothing more."""


def play_in_process(
    job: Job, open_screen: Callable[[], AbstractContextManager[Screen]]
) -> PlayerReport:
    """Play the job in a child process, and return its report; the first Ctrl-C asks it to end.

    The screen is opened while the process joins ROS.

    Raises:
        RobotctlError: The process ended without a report.
        KeyboardInterrupt: Ctrl-C was pressed a second time.
    """
    report = PlayerReport()
    child = start(program(PLAYER), with_stdin=True)
    try:
        with suppress(BrokenPipeError):  # it has ended; the loop below notices
            child.send(f"{job.to_json()}\n".encode())
        with open_screen() as screen:
            player = _Player(child, report, screen)
            with Keyboard(player.suspend, player.resume) as keyboard:
                while not report.ended:
                    try:
                        player.wait_for_input(keyboard)
                    except KeyboardInterrupt:
                        if report.interrupted:
                            raise
                        report.interrupted = True
                        child.close_stdin()
    finally:
        exit_code = child.close(END_DEADLINE_S)
    if not (report.summary or report.error or report.interrupted):
        raise RobotctlError(
            f"the player ended with exit code {exit_code} before the replay was over "
            "(see why with: robotctl --debug replay ...)"
        )
    return report


class _Player:
    """The player process, with the report, the screen and the pause of its replay."""

    def __init__(self, child: Child, report: PlayerReport, screen: Screen) -> None:
        self._child = child
        self._report = report
        self._screen = screen
        self._paused = False
        self._was_playing = False

    def wait_for_input(self, keyboard: Keyboard) -> None:
        """Wait for the player or the keyboard, and handle what comes."""
        child = self._child
        patience_s = None if child.has_stdin else END_DEADLINE_S
        ready, _, _ = select.select([child.fileno(), *keyboard.sources], [], [], patience_s)
        self._report.ended = not ready
        if child.fileno() in ready:
            try:
                for report in child.receive():
                    self._handle(report)
            except EOFError:
                self._report.ended = True
        if not set(ready).isdisjoint(keyboard.sources):
            for key in keyboard.read():
                self._press(key)

    def suspend(self) -> None:
        """Pause the player while this process is stopped."""
        self._was_playing = not self._paused
        self._send(Command.PAUSE)
        self._screen.suspend()

    def resume(self) -> None:
        """Continue, unless the replay was paused before `suspend`."""
        self._screen.resume()
        if self._was_playing:
            self._send(Command.RESUME)

    def _handle(self, report: dict[str, Any]) -> None:
        if "error" in report:
            self._report.error = error_for_exit_code(report["exit_code"], report["error"], report)
        if "progress" in report:
            self._paused = report["progress"]["paused"]
        self._report.summary = report.get("summary", self._report.summary)
        self._screen.show(report)

    def _press(self, key: str) -> None:
        if key == QUIT:
            self._child.close_stdin()
        elif key in KEYS:
            self._send(KEYS[key])

    def _send(self, command: Command) -> None:
        with suppress(BrokenPipeError):  # it has ended; `wait_for_input` notices
            self._child.send(command.line())
