"""What may be asked of a replay under way: a line of JSON each, {"do": COMMAND}."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import Enum

from robotctl.replay.playback_control import PlaybackControl


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


def carry_out(command: Command, control: PlaybackControl) -> None:
    """Do it."""
    actions: dict[Command, Callable[[], None]] = {
        Command.PAUSE: control.pause,
        Command.RESUME: control.resume,
        Command.TOGGLE: control.toggle,
        Command.FASTER: control.faster,
        Command.SLOWER: control.slower,
        Command.NEXT: control.step,
    }
    actions[command]()
