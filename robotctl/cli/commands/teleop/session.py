"""A session of teleop: keys in, held velocities out, until the operator quits."""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Iterator, Mapping
from typing import Any, Final

from robotctl.cli.commands.teleop.gamepad import Gamepad
from robotctl.cli.commands.teleop.held_keys import (
    STAND,
    Hands,
    HandsWithoutReleases,
    HandsWithReleases,
    typed,
)
from robotctl.cli.commands.teleop.holding import STEP, Holding, Speeds
from robotctl.cli.terminal.key_events import Key, KeyEvent, KeyParser
from robotctl.cli.terminal.keyboard import Keyboard
from robotctl.cli.terminal.terminal_answers import ASK_EACH_S, TerminalAnswers
from robotctl.cli.terminal.text import printable
from robotctl.ipc.client import Client, command_for
from robotctl.ipc.method_names import SET_MODE
from robotctl.ipc.protocol import EMERGENCY_STOP_MODE
from robotctl.kernel.course import MAX_SILENCE_S

PERIOD_S: Final = ASK_EACH_S
"""How often the hands are looked at while something is held."""

IDLE_S: Final = 0.1
"""How often the rest is looked at while nothing is held."""

WITH_RELEASES: Final = (
    "hold w a s d or the arrows; a terminal that is silent for 125 ms is zero",
    "a key that stops repeating is let go in 0.8 s, after another key in 3 s",
)
WITHOUT_RELEASES: Final = (
    "hold w a s d or the arrows; nothing moves until the key repeats",
    "this terminal tells no releases: zero 125 ms after the last repeat",
)
KEYS: Final = "+ - speed   space let go   e emergency stop   q quit"
_FASTER, _SLOWER, _LET_GO, _STOP, _QUIT = "+=", "-", " ", "e", "q"


class Quit(Exception):
    """The operator ended the session."""


class TeleopSession:
    """The operator's hands, what they hold, and the text that is shown around them."""

    def __init__(
        self,
        robot: str,
        client: Client,
        params: Mapping[str, Any],
        speeds: Speeds,
        gamepad: Gamepad | None,
    ) -> None:
        self._robot = robot
        self._client = client
        self._params = params
        self._holding = Holding(client, params)
        self._speeds = speeds
        self._gamepad = gamepad
        self._hands: Hands = HandsWithoutReleases()
        self._parser = KeyParser()
        self._answers: TerminalAnswers | None = None
        self._woke_s = time.monotonic()

    def lines(self) -> list[str]:
        """Return the keys, the speeds and what was refused, for the screen."""
        messages = (self._holding.message, self._hands.problem)
        return [
            *self._how_to_move(),
            KEYS,
            f"speed {self._speeds}",
            *(printable(message) for message in messages if message),
        ]

    def _how_to_move(self) -> tuple[str, ...]:
        if self._gamepad is not None:
            return (str(self._gamepad),)
        return WITHOUT_RELEASES if self._answers is None else WITH_RELEASES

    def begin(self, answers: TerminalAnswers | None) -> None:
        """Take a terminal that tells releases, of which `answers` are asked, or another (None)."""
        self._answers = answers
        self._hands = HandsWithoutReleases() if answers is None else HandsWithReleases()
        self._holding.silence_lets_go = answers is None and self._gamepad is None

    def let_go(self) -> None:
        """Hold nothing any more; the robot ramps down."""
        self._forget()
        self._holding.want(STAND)

    def turn(self, keyboard: Keyboard) -> None:
        """Wait for a key, or until a held velocity is due, and send what is wanted.

        Raises:
            Quit: The operator ended the session, or the terminal is gone.
        """
        period_s = PERIOD_S if self._holding.is_held or self._answers else IDLE_S
        if self._answers is not None:
            self._answers.ask()
        sources: list[Any] = (
            keyboard.sources if self._gamepad is None else [*keyboard.sources, self._gamepad]
        )
        ready, _, _ = select.select(sources, [], [], period_s)
        slept_s, self._woke_s = time.monotonic() - self._woke_s, time.monotonic()
        if slept_s > period_s + MAX_SILENCE_S:
            self._forget_the_past(keyboard)
            return
        keys = list(self._keys(keyboard, ready))
        for key in typed(keys, tells_releases=self._answers is not None):
            if key.event is not KeyEvent.RELEASED:
                self._press(key)
        if self._gamepad is None:
            wish = self._hands.take(keys, self._woke_s)
        else:
            wish = self._gamepad.take() if self._gamepad in ready else None
        if wish is not None and not self._holding.want(self._speeds.velocity(wish)):
            self._forget()

    def _keys(self, keyboard: Keyboard, ready: list[Any]) -> Iterator[Key]:
        if set(ready).isdisjoint(keyboard.sources):
            return
        try:
            text = keyboard.read()
        except OSError:
            raise Quit from None
        if not text and keyboard.has_ended(ready):
            raise Quit
        yield from self._parser.feed(text, self._woke_s)

    def _forget(self) -> None:
        self._hands.forget()
        if self._gamepad is not None:
            self._gamepad.forget()

    def _forget_the_past(self, keyboard: Keyboard) -> None:
        """Forget what was pressed before this process was stopped or slow."""
        self._forget()
        keyboard.flush()
        self._parser = KeyParser()
        self._holding.message = "this command was stopped or slow: let go, then hold again"

    def _press(self, key: Key) -> None:
        if key.with_control:
            self._press_control(key.name)
        elif key.name in _FASTER:
            self._speeds.scale(STEP)
        elif key.name == _SLOWER:
            self._speeds.scale(1.0 / STEP)
        elif key.name == _LET_GO:
            self.let_go()
        elif key.name == _QUIT:
            raise Quit
        elif key.name == _STOP:
            self._emergency_stop()

    def _press_control(self, name: str) -> None:
        """Do what the terminal would do where it tells releases: then it sends no signals."""
        if name == "c":
            raise KeyboardInterrupt
        if name == "z":
            os.kill(os.getpid(), signal.SIGTSTP)

    def _emergency_stop(self) -> None:
        self._forget()
        answer = self._client.call(SET_MODE, {**self._params, "mode": EMERGENCY_STOP_MODE})
        cure = f"release it with: {command_for(self._robot, 'reset')}"
        self._holding.message = f"{answer['message']} ({cure})"
