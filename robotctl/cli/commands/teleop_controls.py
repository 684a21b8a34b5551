"""Turn held keys or a gamepad into the wanted motion, and request the motion periodically."""

from __future__ import annotations

import base64
import struct
import time
from collections.abc import Mapping, Sequence
from math import isfinite
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from robotctl.base.errors import Refused, UsageError
from robotctl.cli.targets.ros_view import MessageListener
from robotctl.cli.ui.keys import ANSWER, Key, KeyEvent
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import HOLD, PARAM_LIST
from robotctl.kernel.course import MAX_SILENCE_S
from robotctl.kernel.patterns import MIN_SPEED_MPS
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import Decoder

REPEAT_S: Final = MAX_SILENCE_S
"""Without key releases, a key that repeats within this time [s] is held."""

FIRST_REPEAT_S: Final = 0.8
"""With key releases, a key without a first repeat in this time [s] is released.

Usual delays are 660 ms (X11), 600 ms (KDE), 500 ms (GNOME, Windows), 250 to 375 ms (macOS).
"""

NEXT_REPEAT_S: Final = 0.25
"""With key releases, a key without a next repeat in this time [s] is released.

Usual periods are 25 to 50 ms, 90 ms on macOS.
"""

AFTER_OTHER_S: Final = 3.0
"""The time that a key stays held after another key's release, which ends all repeats [s]."""

MAX_AT_ONCE: Final = 8
"""More keys than this at once are pasted text; the fastest repeat sends 5."""


class Wish(NamedTuple):
    """The wanted motion, as shares (-1 to 1) of the chosen speeds."""

    forward: float
    left: float


STAND: Final = Wish(0.0, 0.0)

STEERING: Final = MappingProxyType(
    {
        **dict.fromkeys(("up", "w"), Wish(1.0, 0.0)),
        **dict.fromkeys(("down", "s"), Wish(-1.0, 0.0)),
        **dict.fromkeys(("left", "a"), Wish(0.0, 1.0)),
        **dict.fromkeys(("right", "d"), Wish(0.0, -1.0)),
    }
)
"""The keys that steer."""

STOPPING: Final = frozenset(" eq")
"""The keys that only stop; pasted ones count, too."""


def typed(keys: list[Key], *, tells_releases: bool) -> list[Key]:
    """Return `keys` without pasted text; the keys in STOPPING always remain.

    Keys marked `is_text` count as pasted text in a terminal that reports key releases
    (`tells_releases`), in others only if more than MAX_AT_ONCE keys came at once.
    """
    if not tells_releases and len(keys) <= MAX_AT_ONCE:
        return keys
    return [key for key in keys if not key.is_text or key.name in STOPPING]


class HandsWithReleases:
    """Keys held in a terminal that reports releases; a key is held from press to release.

    When no key repeats any more, all keys count as released. `problem` is then the text to show.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._held: set[str] = set()
        self._wish = STAND
        self._heard_s = float("-inf")
        self._patience_s = 0.0

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Return the motion of all held keys, or None if it need not be sent.

        It is sent when it has changed, and each time the terminal answers (ANSWER in `keys`).
        """
        for key in keys:
            if key.name != ANSWER and not key.is_text:
                self._hear(key, now_s)
        # A release may be lost, in a multiplexer or when the window loses the focus.
        if self._held and now_s - self._heard_s > self._patience_s:
            self._held.clear()
            self.problem = "let go: no key repeated. Press it again"
        wishes = [STAND, *(STEERING[name] for name in self._held)]
        forward, left = map(sum, zip(*wishes, strict=True))
        wish = Wish(max(-1.0, min(forward, 1.0)), max(-1.0, min(left, 1.0)))
        changes, self._wish = wish != self._wish, wish
        # A dead terminal sends no ANSWER: without new wishes, the robot stops.
        return wish if changes or any(key.name == ANSWER for key in keys) else None

    def forget(self) -> None:
        """Release all keys; a key that is still down counts only after it is pressed again."""
        self._held.clear()
        self._wish = STAND

    def _hear(self, key: Key, now_s: float) -> None:
        self._heard_s = now_s
        if key.event is KeyEvent.RELEASED:
            self._held.discard(key.name)
            self._patience_s = AFTER_OTHER_S
        elif key.event is KeyEvent.REPEATED:
            self._patience_s = NEXT_REPEAT_S
        else:
            self._patience_s = FIRST_REPEAT_S
            if key.name in STEERING and not key.with_control:
                self._held.add(key.name)
                self.problem = ""


class HandsWithoutReleases:
    """Keys held in a terminal that repeats a held key and reports no release.

    The first press of a key moves nothing. After pasted text, no key counts until all steering keys
    have been silent for REPEAT_S.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._last = ""
        self._last_s = float("-inf")
        self._is_forgotten = False

    def take(self, keys: Sequence[Key], now_s: float) -> Wish | None:
        """Return the motion of the last steering key in `keys`, None if it does not repeat."""
        names = [key.name for key in keys if key.name in STEERING]
        is_pasted = len(keys) > MAX_AT_ONCE
        if not (names or is_pasted):
            return None
        name = names[-1] if names else ""  # one read is no repeat: its keys may have been buffered
        is_soon = now_s - self._last_s <= REPEAT_S
        repeats = name == self._last and is_soon
        self._is_forgotten = is_pasted or (self._is_forgotten and is_soon)
        self._last, self._last_s = name, now_s
        return STEERING[name] if names and repeats and not self._is_forgotten else None

    def forget(self) -> None:
        """Release all keys; none counts until all steering keys have been silent for REPEAT_S."""
        self._is_forgotten = True


Hands = HandsWithReleases | HandsWithoutReleases
"""The held keys of a terminal; `problem` is the reason of a release, or ""."""

JOY: Final = "sensor_msgs/msg/Joy"

SILENT_S: Final = 1.0
"""The time without a message before the screen reports the silence [s]."""


class Controls(NamedTuple):
    """Indices in a Joy message: the button that must be held, the forward and the left axis."""

    button: int = 4
    forward_axis: int = 1
    left_axis: int = 0


class Gamepad:
    """A gamepad that publishes on a topic; the robot stands while it sends nothing.

    While one publisher sends, messages of other publishers on the topic are ignored.
    """

    def __init__(self, listener: MessageListener, topic: str, controls: Controls) -> None:
        self._listener = listener
        self._decoder = Decoder(parse_definition(listener.type_name, listener.definition))
        self._topic = topic
        self._controls = controls
        self._is_forgotten = True
        self._publisher = ""
        self._heard_s = float("-inf")
        self._is_down = True  # the button; assumed until a message says otherwise
        self._problem = ""

    def __str__(self) -> str:
        """Return the advice to the operator, with a problem if there is one."""
        button = f"button {self._controls.button} of {self._topic}"
        if time.monotonic() - self._heard_s > SILENT_S:
            return f"nothing is heard on {self._topic}: connect the gamepad (see autorepeat_rate)"
        if self._is_forgotten and self._is_down and not self._problem:
            return f"let go of {button} first"
        how = f"hold {button}, and steer"
        return f"{how} ({self._problem})" if self._problem else how

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when a message arrives."""
        return self._listener.fileno()

    def forget(self) -> None:
        """Command a stop until the operator has released the button that must be held."""
        self._is_forgotten = True

    def take(self) -> Wish | None:
        """Return the wanted motion, STAND if the button is up, or None if no message arrived."""
        ours = [each for each in self._listener.receive(0.0) if self._is_followed(each)]
        if not ours:
            return None
        wish = self._wish(base64.b64decode(ours[-1]["data"]))
        if not self._is_down:
            self._is_forgotten = False
        return STAND if self._is_forgotten else wish

    def _is_followed(self, message: Mapping[str, Any]) -> bool:
        """Return whether the message counts; a second publisher counts only after a silence."""
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
            values = self._decoder.values(data)
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


FIRST_SHARE, STEP = 0.5, 1.1
"""The share of the speed limits at the start, and the factor by which one step changes it."""

CALL_S = 1.0
"""The timeout of the daemon's answer [s]."""


class Speeds:
    """The speeds that the operator chose: the same share of the linear and the angular limit."""

    def __init__(self, client: Client, speed_mps: float | None) -> None:
        """Begin with `speed_mps`, or with FIRST_SHARE of the daemon's limits.

        Raises:
            UsageError: The speed is above the limit.
        """
        listed = client.call(PARAM_LIST)["parameters"]
        limits: dict[str, Any] = {each["key"]: each["value"] for each in listed}
        self._linear_mps: float = limits["limits.linear_mps"]
        self._angular_rps: float = limits["limits.angular_rps"]
        self._least = min(MIN_SPEED_MPS / self._linear_mps, 1.0)
        self._share = FIRST_SHARE if speed_mps is None else speed_mps / self._linear_mps
        if self._share > 1.0:
            cure = f"the limit is {self._linear_mps:g} m/s (limits.linear_mps)"
            raise UsageError(f"--speed {speed_mps:g}", cure)

    def scale(self, factor: float) -> None:
        """Multiply the speeds by `factor`, within MIN_SPEED_MPS and the limits."""
        self._share = min(max(self._share * factor, self._least), 1.0)

    def velocity(self, wish: Wish) -> tuple[float, float]:
        """Return the velocity of `wish` at the chosen speeds [m/s, rad/s]."""
        return (
            wish.forward * self._share * self._linear_mps,
            wish.left * self._share * self._angular_rps,  # also in reverse
        )

    def __str__(self) -> str:
        linear_mps, angular_rps = self.velocity(Wish(1.0, 1.0))
        return f"{linear_mps:.2f} m/s, {angular_rps:.2f} rad/s"


class Holding:
    """Requests the wanted motion; `message` says why the last motion ended or was refused.

    If `want` is not called for MAX_SILENCE_S, the motion ends. Then the next call returns False, or
    begins a new motion if `silence_lets_go` is True.
    """

    def __init__(self, client: Client, params: Mapping[str, Any]) -> None:
        """`params` has source, reason and lease of each request."""
        self.message = ""
        self.silence_lets_go = False
        self._client = client
        self._params = params
        self._number = 0
        self._sent_s = float("-inf")

    @property
    def is_held(self) -> bool:
        """Whether the motion continues, by the daemon's last answer."""
        return self._number != 0

    def want(self, velocity: tuple[float, float]) -> bool:
        """Request motion at `velocity` [m/s, rad/s]; return False if it is refused or has ended."""
        now_s = time.monotonic()
        if self.silence_lets_go and now_s - self._sent_s >= MAX_SILENCE_S:
            self._number = 0
        begins = self._number == 0
        if begins and velocity == STAND:
            return True
        linear_mps, angular_rps = velocity
        given = {"linear_mps": linear_mps, "angular_rps": angular_rps, "hold": self._number}
        self._sent_s = now_s
        try:
            answer = self._client.call(HOLD, {**self._params, **given}, deadline_s=CALL_S)
        except Refused as refused:
            self._number, self.message = 0, str(refused)
            return False
        self._number = answer["hold"]
        if self._number:
            self.message = "" if begins else self.message
        elif velocity != STAND:
            self.message = answer["message"]
            return False
        return True
