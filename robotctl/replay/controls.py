"""What may be asked of a replay under way: a line of JSON each, {"do": COMMAND}."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import Enum

from robotctl.replay.steering import Steering


class Command(Enum):
    """What a key or a suspended terminal asks for."""

    PAUSE = "pause"
    RESUME = "resume"
    TOGGLE = "toggle"
    FASTER = "faster"
    SLOWER = "slower"
    NEXT = "next"

    def line(self) -> bytes:
        """As it is sent to the process that plays."""
        return f"{json.dumps({'do': self.value})}\n".encode()


def command_of(line: bytes) -> Command | None:
    """The command in a line, None where there is none."""
    try:
        said = json.loads(line)
        return Command(said["do"])
    except (ValueError, TypeError, KeyError):
        return None


def carry_out(command: Command, steering: Steering) -> None:
    """Do it."""
    actions: dict[Command, Callable[[], None]] = {
        Command.PAUSE: steering.pause,
        Command.RESUME: steering.resume,
        Command.TOGGLE: steering.toggle,
        Command.FASTER: steering.faster,
        Command.SLOWER: steering.slower,
        Command.NEXT: steering.step,
    }
    actions[command]()
