"""Compares velocity commands with a journal of version 0.1.0: every motion must be decided.

Its journal does not tell how many commands were sent, so they are compared by value, in any order.
"""

from __future__ import annotations

from collections import deque

from robotctl.kernel.types import Effect, PublishTwist
from robotctl.rerun.command_bytes import is_zero, numbers_of, serialized, shown_command

MAX_WAITING = 512
"""The number of commands that may wait for their counterpart."""

STILL_STEPS = 500
"""After this many steps with effects but without motion, no command can still be under way."""


class CommandTraffic:
    """The comparison of published and decided commands: by value, in any order, each once.

    Commands of zero are ignored: they are always allowed.
    """

    def __init__(self) -> None:
        self.seen = 0
        self.undecided = 0
        """The number of commands, other than zero, without a decision."""

        self.example = ""
        """The first of them, as text."""

        self._decided: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._published: deque[bytes] = deque()
        self._still_steps = 0

    def message(self, data: bytes) -> None:
        """Take a message of the command topic."""
        self.seen += 1
        numbers = numbers_of(data)
        if is_zero(numbers):
            return
        try:
            self._decided.remove(numbers)
        except ValueError:
            self._published.append(numbers)
            if len(self._published) > MAX_WAITING:
                self._give_up()

    def step(self, effects: tuple[Effect, ...]) -> None:
        """Take the effects of one step."""
        self._still_steps += 1
        for effect in effects:
            if isinstance(effect, PublishTwist) and (effect.twist.linear or effect.twist.angular):
                self._still_steps = 0
                numbers = serialized(effect.twist)
                try:
                    self._published.remove(numbers)
                except ValueError:
                    self._decided.append(numbers)
        if self._still_steps == STILL_STEPS:
            self._decided.clear()
            self.end()

    def end(self) -> None:
        """Count all commands that still wait for a decision: no decision follows."""
        while self._published:
            self._give_up()

    def _give_up(self) -> None:
        numbers = self._published.popleft()
        self.undecided += 1
        self.example = self.example or shown_command(numbers)
