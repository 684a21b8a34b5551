"""Commands for a running replay: a line of JSON each, {"do": COMMAND}."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import Enum

from robotctl.replay.playback_control import PlaybackControl


class Command(Enum):
    """What a key or a suspended terminal requests."""

    PAUSE = "pause"
    RESUME = "resume"
    TOGGLE = "toggle"
    FASTER = "faster"
    SLOWER = "slower"
    NEXT = "next"

    def line(self) -> bytes:
        """Return the line that is sent to the replay process."""
        return f"{json.dumps({'do': self.value})}\n".encode()


def command_of(line: bytes) -> Command | None:
    """Return the command in a line, or None."""
    try:
        message = json.loads(line)
        return Command(message["do"])
    except (ValueError, TypeError, KeyError):
        return None


def carry_out(command: Command, control: PlaybackControl) -> None:
    """Apply a command."""
    actions: dict[Command, Callable[[], None]] = {
        Command.PAUSE: control.pause,
        Command.RESUME: control.resume,
        Command.TOGGLE: control.toggle,
        Command.FASTER: control.faster,
        Command.SLOWER: control.slower,
        Command.NEXT: control.step,
    }
    actions[command]()
