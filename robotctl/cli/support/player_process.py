"""The process that plays a recording: started, heard, steered and ended from the command line."""

from __future__ import annotations

import select
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any

from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.replay_screen import Screen
from robotctl.errors import RobotctlError, error_for_exit_code
from robotctl.processes import Child, program, start
from robotctl.replay.controls import Command
from robotctl.replay.job import Job

PLAYER = program("robotctl.replay")

END_DEADLINE_S = 15.0
"""For the player to take its publishers off the graph and leave."""

KEYS = {
    " ": Command.TOGGLE,
    "+": Command.FASTER,
    "=": Command.FASTER,
    "-": Command.SLOWER,
    "n": Command.NEXT,
}
"""Beside QUIT; `=` is where keyboards have the plus."""

QUIT = "q"


@dataclass(slots=True)
class Outcome:
    """What came of a replay, as far as is known."""

    summary: dict[str, Any] = field(default_factory=dict)
    error: RobotctlError | None = None
    interrupted: bool = False
    ended: bool = False
    """The player has nothing more to say."""


def play(
    job: Job, outcome: Outcome, open_screen: Callable[[], AbstractContextManager[Screen]]
) -> None:
    """Have a process play the job and show what it says; the first Ctrl-C asks it to end.

    The screen is opened while that process starts.
    """
    child = start(PLAYER, obeys=True)
    try:
        with suppress(BrokenPipeError):  # it has ended, which is seen below
            child.tell(f"{job.to_json()}\n".encode())
        with open_screen() as screen:
            player = _Player(child, outcome, screen)
            with Keyboard(player.suspend, player.resume) as keyboard:
                while not outcome.ended:
                    try:
                        player.attend(keyboard)
                    except KeyboardInterrupt:
                        if outcome.interrupted:
                            raise
                        outcome.interrupted = True
                        child.hang_up()
    finally:
        exit_code = child.close(END_DEADLINE_S)
    if not (outcome.summary or outcome.error or outcome.interrupted):
        raise RobotctlError(
            f"the player ended with {exit_code} before the replay did "
            "(see why with: robotctl --debug replay ...)"
        )


class _Player:
    """The other process, as seen from here."""

    def __init__(self, child: Child, outcome: Outcome, screen: Screen) -> None:
        self._child = child
        self._outcome = outcome
        self._screen = screen
        self._paused = False
        self._resumes = False

    def attend(self, keyboard: Keyboard) -> None:
        """Wait for what is said or pressed next, and see to it."""
        child = self._child
        patience_s = None if child.obeys else END_DEADLINE_S
        ready, _, _ = select.select([child.fileno(), *keyboard.sources], [], [], patience_s)
        self._outcome.ended = not ready
        if child.fileno() in ready:
            try:
                for said in child.hear():
                    self._hear(said)
            except EOFError:
                self._outcome.ended = True
        if not set(ready).isdisjoint(keyboard.sources):
            for key in keyboard.read():
                self._press(key)

    def suspend(self) -> None:
        """Stand still as long as this process does."""
        self._resumes = not self._paused
        self._send(Command.PAUSE)
        self._screen.suspend()

    def resume(self) -> None:
        """Go on, unless it stood still before."""
        self._screen.resume()
        if self._resumes:
            self._send(Command.RESUME)

    def _hear(self, said: dict[str, Any]) -> None:
        if "error" in said:
            self._outcome.error = error_for_exit_code(said["exit_code"], said["error"], said)
        if "progress" in said:
            self._paused = said["progress"]["paused"]
        self._outcome.summary = said.get("summary", self._outcome.summary)
        self._screen.show(said)

    def _press(self, key: str) -> None:
        if key == QUIT:
            self._child.hang_up()
        elif key in KEYS:
            self._send(KEYS[key])

    def _send(self, command: Command) -> None:
        with suppress(BrokenPipeError):  # it has ended, which `attend` sees
            self._child.tell(command.line())
