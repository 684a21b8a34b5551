"""The keys that control a replay."""

from __future__ import annotations

from typing import Final

from robotctl.replay.commands import Command

KEYS: Final = {
    " ": Command.TOGGLE,
    "+": Command.FASTER,
    "=": Command.FASTER,
    "-": Command.SLOWER,
    "n": Command.NEXT,
}
"""All keys but QUIT; `=` is the plus key without Shift."""

QUIT: Final = "q"
