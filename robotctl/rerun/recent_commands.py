"""The last decided commands: a stall tells afterwards which of them were withheld."""

from __future__ import annotations

from collections import deque

from robotctl.rerun.command_bytes import is_zero

MOST = 64
"""The number of commands that are kept."""


class RecentCommands:
    """Numbers and velocities, the oldest first."""

    def __init__(self) -> None:
        self._commands: deque[tuple[int, bytes]] = deque(maxlen=MOST)

    @property
    def were_moving(self) -> bool:
        """Whether the last command was not zero."""
        return bool(self._commands) and not is_zero(self._commands[-1][1])

    def add(self, number: int, numbers: bytes) -> None:
        """Keep a command: its number, and the numbers of its velocity."""
        self._commands.append((number, numbers))

    def withheld(self, count: int) -> list[int]:
        """Return the numbers of the last commands, of which `count` were not zero."""
        held: list[int] = []
        for number, numbers in reversed(self._commands):
            if count <= 0:
                break
            held.append(number)
            count -= not is_zero(numbers)
        return held[::-1]

    def clear(self) -> None:
        """Forget all."""
        self._commands.clear()
