"""The process that plays a recording: started, heard, steered and ended from the command line."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import Any

from robotctl.cli.keyboard import Keyboard
from robotctl.cli.replay_screen import Screen
from robotctl.errors import RobotctlError, error_for_exit_code
from robotctl.replay.controls import Command
from robotctl.replay.job import Job
from robotctl.replay.lines import Lines

PLAYER = (sys.executable, "-P", "-m", "robotctl.replay")
"""-P: what lies in the working directory is not imported in place of a library."""

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
    process = subprocess.Popen(
        PLAYER,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,  # a Ctrl-C is ours to pass on: it may come while Python starts there
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with suppress(BrokenPipeError):  # it has ended, and says so on stdout
            os.write(process.stdin.fileno(), f"{job.to_json()}\n".encode())
        with open_screen() as screen:
            player = _Player(process, outcome, screen)
            with Keyboard(player.suspend, player.resume) as keyboard:
                while not outcome.ended:
                    try:
                        player.attend(keyboard)
                    except KeyboardInterrupt:
                        if outcome.interrupted:
                            raise
                        outcome.interrupted = True
                        process.stdin.close()
    finally:
        process.stdin.close()
        process.stdout.close()
        try:
            process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if not (outcome.summary or outcome.error or outcome.interrupted):
        raise RobotctlError(
            f"the player ended with {process.returncode} before the replay did "
            "(see why with: robotctl --debug replay ...)"
        )


class _Player:
    """The other process, as seen from here."""

    def __init__(self, process: subprocess.Popen[bytes], outcome: Outcome, screen: Screen) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._stdin, self._stdout = process.stdin, process.stdout
        self._outcome = outcome
        self._screen = screen
        self._lines = Lines()
        self._paused = False
        self._resumes = False

    def attend(self, keyboard: Keyboard) -> None:
        """Wait for what is said or pressed next, and see to it."""
        patience_s = END_DEADLINE_S if self._stdin.closed else None
        ready, _, _ = select.select([self._stdout.fileno(), *keyboard.sources], [], [], patience_s)
        self._outcome.ended = not ready
        if self._stdout.fileno() in ready:
            piece = os.read(self._stdout.fileno(), 1 << 16)
            self._outcome.ended = not piece
            for line in self._lines.feed(piece):
                self._hear(json.loads(line))
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
            self._outcome.error = error_for_exit_code(said["exit_code"], said["error"])
        if "progress" in said:
            self._paused = said["progress"]["paused"]
        self._outcome.summary = said.get("summary", self._outcome.summary)
        self._screen.show(said)

    def _press(self, key: str) -> None:
        if key == QUIT:
            self._stdin.close()
        elif key in KEYS:
            self._send(KEYS[key])

    def _send(self, command: Command) -> None:
        if not self._stdin.closed:
            with suppress(BrokenPipeError):  # it has ended, and says so on stdout
                os.write(self._stdin.fileno(), command.line())
