"""A gamepad as operator's hands: `sensor_msgs/Joy` on a topic, with a button that must be held."""

from __future__ import annotations

import base64
import struct
import time
from collections.abc import Mapping
from math import isfinite
from typing import Any, Final, NamedTuple

from robotctl.cdr.definition import Definition, parse_definition
from robotctl.cdr.values import decode
from robotctl.cli.commands.teleop.held_keys import STAND, Wish
from robotctl.cli.support.ros_view import MessageListener
from robotctl.kernel.course import MAX_SILENCE_S

JOY: Final = "sensor_msgs/msg/Joy"

SILENT_S: Final = 1.0
"""After this time without a message the screen says so; the robot stands long before."""


class Controls(NamedTuple):
    """The numbers of the button that must be held, and of the axes: forward, to the left."""

    button: int = 4
    forward_axis: int = 1
    left_axis: int = 0


class Gamepad:
    """The gamepad of a topic. While it sends nothing, the robot stands, as after a release.

    While one publisher is heard, those of others on the topic are ignored.
    """

    def __init__(self, listener: MessageListener, topic: str, controls: Controls) -> None:
        self._listener = listener
        self._definition: Definition = parse_definition(listener.type_name, listener.definition)
        self._topic = topic
        self._controls = controls
        self._is_forgotten = True
        self._publisher = ""
        self._heard_s = float("-inf")
        self._is_down = True  # as long as nothing else is known
        self._problem = ""

    def __str__(self) -> str:
        """Say what to do, or why nothing moves."""
        button = f"button {self._controls.button} of {self._topic}"
        if time.monotonic() - self._heard_s > SILENT_S:
            return f"nothing is heard on {self._topic}: connect the gamepad (see autorepeat_rate)"
        if self._is_forgotten and self._is_down and not self._problem:
            return f"let go of {button} first"
        how = f"hold {button}, and steer"
        return f"{how} ({self._problem})" if self._problem else how

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when the gamepad says something."""
        return self._listener.fileno()

    def forget(self) -> None:
        """Let go: the button must be released before it counts again."""
        self._is_forgotten = True

    def take(self) -> Wish | None:
        """Return what the last message wants, None if none is complete yet."""
        ours = [each for each in self._listener.receive(0.0) if self._is_followed(each)]
        if not ours:
            return None
        wish = self._wish(base64.b64decode(ours[-1]["data"]))
        if not self._is_down:
            self._is_forgotten = False
        return STAND if self._is_forgotten else wish

    def _is_followed(self, message: Mapping[str, Any]) -> bool:
        """Return whether the message is of the gamepad that is followed; follow one if none is."""
        now_s = time.monotonic()
        if message["publisher"] != self._publisher:
            if now_s - self._heard_s <= MAX_SILENCE_S:
                self._problem = f"a second node publishes on {self._topic}: it is ignored"
                return False
            self._publisher = message["publisher"]
            self._is_down = True
            self.forget()
        self._heard_s = now_s
        return True

    def _wish(self, data: bytes) -> Wish:
        button, forward, left = self._controls
        try:
            values: dict[str, Any] = decode(self._definition, data)
            is_held = bool(values["buttons"][button])
            wish = Wish(_share(values["axes"][forward]), _share(values["axes"][left]))
        except struct.error:
            self._problem = f"unreadable messages on {self._topic}"
            return STAND
        except IndexError:
            self._problem = (
                f"it has {len(values['buttons'])} buttons and {len(values['axes'])} axes, "
                f"without button {button} or axes {forward}, {left}"
            )
            return STAND
        self._problem, self._is_down = "", is_held
        return wish if is_held else STAND


def _share(value: float) -> float:
    return max(-1.0, min(value, 1.0)) if isfinite(value) else 0.0
