"""The process that plays a recording: it imports rclpy while the options of `replay` are parsed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Final

from robotctl.cli.support.early_process import started_early

PLAYER: Final = "robotctl.replay"

_PLAYS_NOTHING: Final = frozenset(
    {"--check", "--what-if", "--resim", "--draw-only", "--help", "-h"}
)
"""Options with which `replay` publishes nothing on ROS."""


def early_player(arguments: Sequence[str]) -> AbstractContextManager[None]:
    """Start the process if the command line seems to need it, for a `with` block."""
    options = {word.partition("=")[0] for word in arguments}
    needed = arguments[:1] == ["replay"] and len(arguments) > 1
    if not needed or options & _PLAYS_NOTHING:
        return nullcontext()
    return started_early(PLAYER)
